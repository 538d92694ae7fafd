"""``dslab experiment``."""

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from experiments.cli.console import out, print_json_line, progress_bars, single_threaded_opencv
from experiments.cli.fuzz import fuzz_command

app = typer.Typer(help="Many units through base and Dual-SLAM, counted.", no_args_is_help=True)
app.command("fuzz")(fuzz_command)


@app.callback()
def _group() -> None:
    """Many units through base and Dual-SLAM, counted."""


@app.command("run")
def run_command(
    name: Annotated[Literal["smoke"], typer.Argument(help="The experiment.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Result folder; absent or empty.")],
    units: Annotated[int, typer.Option(min=1, help="Number of units, one seed each.")] = 20,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    scenario: Annotated[str, typer.Option(help="Scenario: a name or a YAML file.")] = "stressed",
    as_json: Annotated[bool, typer.Option("--json", help="Print the counts as one line of JSON.")] = False,
) -> None:
    """Run seeds of a scenario through base and Dual-SLAM on the same images; count failures against Eq. 1.

    Of a family every seed is another scenario. Writes units.parquet, one row per unit. For example:

    `dslab experiment run smoke --out out/smoke --units 10`
    """
    from dataclasses import asdict

    from experiments.files import plain
    from experiments.output import check_free
    from experiments.smoke import run_smoke
    from scenarios.families import load_family

    check_free(out_dir)
    single_threaded_opencv()
    family = load_family(scenario)
    drawn = [family.sample(seed) for seed in range(family.seed, family.seed + units)]
    with progress_bars() as show:
        show(f"experiment {name}", 0, units)
        result, rows = run_smoke(
            drawn, out_dir, workers, lambda done, total: show(f"experiment {name}", done, total)
        )
    if as_json:
        print_json_line(plain(asdict(result)))
        return
    out.print(_table(result, family.name))
    out.print(
        "pr|B is conditional on breakage in the free arm, where recovery only ever runs after one. By the "
        "chain rule p0 · pr|B equals the measured share, so this table cannot refute Eq. 1: that takes the "
        "pr of a crossing arm, in which every unit is crossed backward whether or not the base broke."
    )
    for row in rows:
        if row["message"] or row["void_reason"]:
            out.print(f"seed {row['seed']}: {row['outcome']}: {row['message'] or row['void_reason']}")
    out.print(f"one row per unit in {out_dir / 'units.parquet'}")


def _table(result, scenario: str) -> Table:
    healthy = result.units - result.void - result.errors
    table = Table(
        title=f"{scenario}: {result.units} units, {result.void} void, {result.errors} infrastructure errors, "
        f"{healthy} counted"
    )
    for column in ("", "count", "share", "95 % Clopper-Pearson"):
        table.add_column(column, justify="left" if not column else "right")
    rows = {
        "p0: base breaks in an exposed segment (B)": result.p0,
        "pr|B: recovery fails, given B (R_1|B)": result.pr_given_b,
        "measured failure: B and R_1 (D_1)": result.measured,
        "base relocalizes later, given B": result.relocalized,
        "base not tracking at the end": result.base_failure,
        "silent: map corrupted, nothing declared": result.silent,
        "no re-initialisation, given B": result.no_reinit,
        "false recovery, of fusions judged": result.false_recovery,
    }
    for label, p in rows.items():
        share = "-" if p.estimate is None else f"{p.estimate:.3f}"
        table.add_row(label, f"{p.events} / {p.units}", share, f"{p.low:.3f} to {p.high:.3f}")
        if p is result.pr_given_b:
            predicted = "-" if result.predicted is None else f"{result.predicted:.3f}"
            table.add_row("predicted p0 · pr|B (chain rule)", "", predicted, "")
    return table
