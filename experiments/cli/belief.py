"""``dslab belief``: fit and judge what is believed of places."""

from pathlib import Path
from typing import Annotated

import typer

from dslab.experiments.cli.console import number, print_rows, say

_HELP = """Fit the model of what a view says of a supposed place, and judge it, by logged hypotheses.

A batch with `hypotheses: true` logs them. Fit with some seeds, judge with others. For example:

`dslab belief fit out/places --out fitted.json`

`dslab belief judge out/other-places --fitted fitted.json --plot reliability.png`
"""
app = typer.Typer(help=_HELP, no_args_is_help=True)
_Folders = Annotated[
    list[Path], typer.Argument(metavar="BATCH...", help="Folders of batches, or collected logs.")
]
_Runs = Annotated[
    tuple[int, int] | None,
    typer.Option("--runs", metavar="FIRST LAST", help="Only runs of these numbers, of every sequence."),
]


@app.command("collect")
def collect_command(
    folders: _Folders,
    out_file: Annotated[Path, typer.Option("--out", metavar="FILE.parquet", help="For the collected logs.")],
    views: Annotated[
        int, typer.Option(min=0, help="Most views of a hypothesis, evenly spaced; 0: what loops tear.")
    ] = 8,
    right_joins: Annotated[int, typer.Option(min=1, help="Most right joins of a run.")] = 20,
) -> None:
    """Put the logs of batches into one thinned file; `fit` and `judge` take it as they take folders.

    For example:

    `dslab belief collect out/places --out places.parquet`
    """
    from dslab.experiments.belief.logs import collect

    hypotheses, kept = collect(folders, out_file, views, right_joins)
    say(f"{hypotheses} hypotheses with {kept} rows in {out_file}")


@app.command("fit")
def fit_command(
    folders: _Folders,
    out_file: Annotated[Path, typer.Option("--out", metavar="FILE.json", help="For what was fitted.")],
    runs: _Runs = None,
) -> None:
    """Find the model's parameters of most likelihood.

    For example:

    `dslab belief fit out/places --out fitted.json`

    `dslab belief fit places.parquet --runs 0 3 --out fitted.json` to judge with the others
    """
    from dslab.experiments.belief.fit import fit
    from dslab.experiments.belief.logs import read_logs
    from dslab.experiments.belief.tables import write_fitted
    from dslab.experiments.runs.provenance import commit

    asked = read_logs(folders, _numbers(runs))
    counts = {False: 0, True: 0}
    for one in asked:
        counts[one.false] += 1
    say(f"{counts[False]} right and {counts[True]} false hypotheses")
    fitted_to = {
        "batches": [folder.name for folder in folders], "right": counts[False], "false": counts[True],
        "runs": runs, "commit": commit(),
    }  # fmt: skip
    write_fitted(out_file, fit(asked), fitted_to)
    say(f"parameters in {out_file}")


@app.command("judge")
def judge_command(
    folders: _Folders,
    fitted_file: Annotated[
        Path, typer.Option("--fitted", metavar="FILE.json", help="Of `dslab belief fit`.")
    ],
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw how often is so what is believed.")
    ] = None,
    runs: _Runs = None,
) -> None:
    """Say how often hypotheses are right that are held so likely.

    For example:

    `dslab belief judge out/other-places --fitted fitted.json`
    """
    import numpy as np

    from dslab.experiments.belief.judge import beliefs, judge
    from dslab.experiments.belief.logs import read_logs
    from dslab.experiments.belief.plot import draw
    from dslab.experiments.belief.tables import read_fitted

    fitted, asked = read_fitted(fitted_file), read_logs(folders, _numbers(runs))
    false = np.array([one.false for one in asked])
    odds = beliefs(asked, fitted.parameters)
    kinds = {"all": np.ones(len(asked), bool)}
    kinds |= {kind: np.array([o.kind == kind for o in asked]) for kind in sorted({o.kind for o in asked})}
    rows = []
    for kind, own in kinds.items():
        found = judge(odds[own], false[own])
        rows.append(
                {
                    "kind": kind, "right": found.hypotheses - found.false, "false": found.false,
                    "slope": number(found.slope, 2), "log loss": number(found.loss, 3),
                    "recall at no false one": number(found.recall, 3),
                }
            )  # fmt: skip
    print_rows(rows, f"{len(asked)} hypotheses")
    if plot is not None:
        draw(odds, false, plot)
        say(f"plot in {plot}")


def _numbers(runs: tuple[int, int] | None) -> range | None:
    return None if runs is None else range(runs[0], runs[1] + 1)
