"""``dslab experiment fuzz``."""

from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Any

import typer

from dslab.experiments.cli.console import (
    FolderOption,
    ModeOption,
    WorkersOption,
    print_rows,
    progress_bars,
    say,
)
from dslab.scenarios.errors import InputError


def fuzz_command(
    out_dir: FolderOption,
    units: Annotated[int, typer.Option(min=1, help="Number of scenarios, one seed each.")] = 20,
    start: Annotated[int, typer.Option(min=0, help="First seed.")] = 0,
    systems: Annotated[str, typer.Option("--system", help="Systems, separated by commas.")] = "base,dual",
    mode: ModeOption = "lockstep",
    workers: WorkersOption = 1,
    timeout_s: Annotated[float, typer.Option(min=1, help="Time limit of a run in seconds.")] = 600.0,
) -> None:
    """Run random scenarios and check that no run raises, hangs or leaves an inconsistent map.

    Writes units.jsonl, one row per run, the same for any number of processes. The exit code is 1 if any run
    failed. For example:

    `dslab experiment fuzz --units 20 --system base,dual --out out/fuzz`
    """
    from dslab.experiments.fuzz.fuzzing import UNITS_FILE, FuzzUnit, failed, replay_command, run_fuzz
    from dslab.sim.io.folders import check_free
    from dslab.slam.factory import SYSTEMS

    check_free(out_dir)
    kinds: Any = tuple(systems.split(","))
    if not set(kinds) <= set(SYSTEMS) or len(set(kinds)) < len(kinds):
        remedy = f"use one or more of {','.join(SYSTEMS)}"
        raise InputError("--system", f"{systems!r} is not a list of systems", remedy)
    seeds = range(start, start + units)
    chosen = [FuzzUnit(seed, kind, mode) for seed in seeds for kind in kinds]
    with progress_bars() as show:
        show("experiment fuzz", 0, len(chosen))

        def report(row: dict, done: int, total: int) -> None:
            show("experiment fuzz", done, total)
            for bad in failed([row]):
                at = f" at {bad['stage']}" if bad["stage"] else ""
                say(f"seed {bad['seed']}, {bad['system']}: {bad['outcome']}{at}: {bad['message']}")
                say(bad["traceback"].rstrip())
                say(f"again: {replay_command(bad)}")

        rows = run_fuzz(chosen, out_dir, workers, timeout_s, report)
    print_rows(_sums(rows, kinds), f"{len(rows)} runs")
    say(f"one row per run in {out_dir / UNITS_FILE}")
    if failed(rows):
        raise typer.Exit(1)


def _sums(rows: list[dict], kinds: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    of = {kind: [row for row in rows if row["system"] == kind] for kind in kinds}
    ends = {kind: Counter(row["outcome"] for row in of[kind]) for kind in kinds}
    for outcome in dict.fromkeys(["ok", *sorted({row["outcome"] for row in rows})]):
        yield {"sum over the runs": outcome.replace("_", " "), **{k: ends[k][outcome] for k in kinds}}
    for name in (
        "frames", "tracked", "breakages", "relocalizations", "loops", "dropped_maps", "recoveries_begun",
        "recovered", "fusions",
    ):  # fmt: skip
        sums = {kind: sum(row[name] or 0 for row in of[kind]) for kind in kinds}
        yield {"sum over the runs": name.replace("_", " "), **sums}
