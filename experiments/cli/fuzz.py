"""``dslab experiment fuzz``."""

from collections import Counter
from typing import Annotated

import typer
from rich.table import Table

from dslab.experiments.cli.console import (
    FolderOption,
    ModeChoice,
    ModeOption,
    out,
    print_table,
    progress_bars,
)


def fuzz_command(
    out_dir: FolderOption,
    units: Annotated[int, typer.Option(min=1, help="Number of scenarios, one seed each.")] = 20,
    start: Annotated[int, typer.Option(min=0, help="First seed.")] = 0,
    systems: Annotated[str, typer.Option("--system", help="Systems, separated by commas.")] = "base,dual",
    mode: ModeOption = ModeChoice.LOCKSTEP,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    timeout_s: Annotated[float, typer.Option(min=1, help="Time limit of a run in seconds.")] = 600.0,
) -> None:
    """Run random scenarios and check that no run raises, hangs or leaves an inconsistent map.

    Writes units.jsonl, one row per run, the same for any number of processes. The exit code is 1 if any run
    failed. For example:

    `dslab experiment fuzz --units 20 --system base,dual --out out/fuzz`
    """
    from dslab.experiments.fuzz.fuzzing import FuzzUnit, failed, run_fuzz
    from dslab.sim.io.folders import check_free

    check_free(out_dir)
    kinds = _kinds(systems)
    chosen = [FuzzUnit(seed, kinds, mode.value) for seed in range(start, start + units)]
    with progress_bars() as show:
        show("experiment fuzz", 0, units * len(kinds))

        def report(row: dict, done: int, total: int) -> None:
            show("experiment fuzz", done, total)
            _print_failure(row)

        rows = run_fuzz(chosen, out_dir, workers, timeout_s, report)
    print_table(_table(rows, kinds))
    out.print(f"one row per run in {out_dir / 'units.jsonl'}", soft_wrap=True)
    if failed(rows):
        raise typer.Exit(1)


def _print_failure(row: dict) -> None:
    """Print failure, traceback and repeat command of a failed run."""
    from dslab.experiments.fuzz.fuzzing import failed, replay_command

    for bad in failed([row]):
        at = f" at {bad['stage']}" if bad["stage"] else ""
        out.print(f"seed {bad['seed']}, {bad['system']}: {bad['outcome']}{at}: {bad['message']}")
        out.print(bad["traceback"].rstrip(), soft_wrap=True)
        out.print(f"again: {replay_command(bad)}", soft_wrap=True)


def _kinds(text: str) -> tuple:
    from typing import get_args

    from dslab.experiments.runs.execution import SystemKind
    from dslab.scenarios.errors import InputError

    kinds = tuple(text.split(","))
    known = get_args(SystemKind)
    wrong = [kind for kind in kinds if kind not in known]
    if wrong or len(set(kinds)) < len(kinds):
        raise InputError(
            "--system", f"{text!r} is not a list of systems", f"use one or more of {','.join(known)}"
        )
    return kinds


def _table(rows: list[dict], kinds: tuple[str, ...]) -> Table:
    table = Table(title=f"{len(rows)} runs")
    table.add_column("sum over the runs")
    for kind in kinds:
        table.add_column(kind, justify="right")
    of = {kind: [row for row in rows if row["system"] == kind] for kind in kinds}
    for outcome in sorted({row["outcome"] for row in rows} | {"ok"}, key=lambda o: (o != "ok", o)):
        counts = [Counter(row["outcome"] for row in of[kind])[outcome] for kind in kinds]
        table.add_row(outcome.replace("_", " "), *map(str, counts))
    for name in ("frames", "tracked", "breakages", "relocalizations", "loops", "dropped_maps",
                 "recoveries_begun", "recovered", "fusions"):  # fmt: skip
        table.add_row(
            name.replace("_", " "), *(str(sum(row[name] or 0 for row in of[kind])) for kind in kinds)
        )
    for name, label in (("render_cpu_s", "rendering, CPU s each"), ("slam_cpu_s", "run, CPU s each")):
        known = [[row[name] for row in of[kind] if row[name] is not None] for kind in kinds]
        table.add_row(label, *(f"{sum(k) / len(k):.1f}" if k else "-" for k in known))
    return table
