"""``dslab paper``."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from dslab.experiments.cli.console import JsonOption, out, print_json_line, print_rows, say

Row = dict[str, Any]


def paper_command(
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for paper.json and the plot; absent or empty.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Test Pr(failure) = p0 · prⁿ on Tables II and III of the paper.

    Runs no SLAM. With --out writes paper.json, paper.png and paper.svg. For example:

    `dslab paper`

    `dslab paper --out out/paper`
    """
    from dslab.experiments.report.plain_data import as_data
    from dslab.experiments.statistics.paper import CAVEATS, reanalyse

    figures = {"rows": as_data(reanalyse()), "caveats": list(CAVEATS)}
    if out_dir is not None:
        _write(figures, out_dir)
    if as_json:
        print_json_line(figures)
        return
    for title, columns in _tables().items():
        rows = [
            {"system,\ndata set": f"{row['counts']['system']}\n{row['counts']['dataset']}"}
            | {name: cell(row) for name, cell in columns.items()}
            for row in figures["rows"]
        ]
        print_rows((part for row in rows for part in (row, {})), title)
    out.print("Note:")
    for caveat in CAVEATS:
        out.print(f"- {caveat}")
    if out_dir is not None:
        say(f"{out_dir / 'paper.json'}, paper.png and paper.svg")


def _write(figures: dict[str, Any], out_dir: Path) -> None:
    from dslab.experiments.report.plots.draw import rendered
    from dslab.experiments.report.plots.paper import draw_paper
    from dslab.experiments.report.plots.style import settings
    from dslab.experiments.runs.files import to_json
    from dslab.sim.io.folders import new_directory

    with settings(), new_directory(out_dir) as partial:
        rendered("paper", "", draw_paper(figures["rows"])).write(partial)
        (partial / "paper.json").write_text(to_json(figures, indent=1) + "\n", encoding="utf-8")


def _tables() -> dict[str, dict[str, Callable[[Row], str]]]:
    from dslab.experiments.report.describe import ends, ends_percent, number, p_value, percent

    def counted(name: str) -> Callable[[Row], str]:
        def cell(row: Row) -> str:
            share = row[name]
            between = ends_percent(share).removesuffix(" %")
            return f"{share['events']}/{share['units']}\n{percent(share['estimate'])}\n{between}"

        return cell

    def ratio(name: str) -> Callable[[Row], str]:
        return lambda row: f"{number(row[name]['value'])}\n{ends(row[name])}"

    def predicted(row: Row) -> str:
        found = row["predicted"]
        return f"{percent(found['value'])}\n{ends_percent(found).removesuffix(' %')}"

    return {
        "Counts of the paper; below each share its 95 % Clopper-Pearson interval in %": {
            "ORB-SLAM\nfails": counted("base_failure"),
            "needs\nrecovery, p0": counted("p0"),
            "thread 1\nfails": counted("thread_1"),
            "then thread 2\nfails": counted("thread_2"),
        },
        "Eq. 1 with n = 2": {
            "predicted,\np0 · pr²": predicted,
            "measured": counted("measured"),
            "measured /\npredicted": ratio("ratio"),
            "threads\nalike, p": lambda row: p_value(row["alike_p"]),
            "ratio, ten\ntrials as one": ratio("ratio_if_alike"),
        },
    }
