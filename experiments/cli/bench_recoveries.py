"""``dslab bench recoveries``."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from dslab.experiments.cli.console import (
    JsonOption,
    number,
    out,
    parse_seeds,
    print_json_line,
    print_table,
    progress_bars,
    single_threaded_opencv,
)


def recoveries_command(
    scenarios: Annotated[list[str], typer.Argument(metavar="SCENARIO...", help="Names or files.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder of the rows; resumed if it exists.")],
    seeds: Annotated[str, typer.Option(help="Seeds of each scenario, such as 7 or 1-10.")] = "1-5",
    threads: Annotated[
        str, typer.Option(help="Recovery threads in order, separated by commas.")
    ] = "orb,sift",
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Count how often recoveries rescue healthy maps that broke, over sequences with ground truth.

    Each thread runs to its end, and maps come together by recovery alone; the table says how many seconds
    after its start. A map is healthy if its live poses of the last 5 s lie within 0.1 m, or 5 % of the path.
    Views are hopeless where those without stress on either side share less than a fifth of what they see, by
    exact depth. Stopped and started again, it goes on where it was. For example:

    `dslab bench recoveries stressed --seeds 1-20 --threads orb,direct,sift --out out/rescued`
    """
    from dslab.experiments.benchmarks.recoveries import measure_recoveries, recovery_sums
    from dslab.slam.dual.recovery.registry import parse_threads

    try:
        kinds = [spec.kind for spec in parse_threads(threads)]
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--threads") from None
    if not kinds:
        raise typer.BadParameter("name at least one thread", param_hint="--threads")
    single_threaded_opencv()
    with progress_bars() as show:
        rows = measure_recoveries(scenarios, parse_seeds(seeds), threads, out_dir, workers, show)
    sums = recovery_sums(rows)
    if as_json:
        print_json_line(sums.to_dict("records"))
        return
    for scenario, of_scenario in sums.groupby("scenario"):
        _print_sums(str(scenario), kinds, of_scenario.to_dict("records"))
    if sums.empty:
        out.print("no healthy map broke")


def _print_sums(scenario: str, kinds: list[str], sums: list[dict[str, Any]]) -> None:
    table = Table(title=f"{scenario}: healthy maps that broke, and the threads that found back")
    for column in ("during", "views"):
        table.add_column(column)
    for column in ("broke", "rescued", *kinds, "false", "fused, s", "95 %"):
        table.add_column(column, justify="right")
    for row in sums:
        found = (row.get(f"thread_{k}", 0) for k in range(1, len(kinds) + 1))
        counts = (row["breakages"], row["rescued"], *found, row["false_fusion"])
        times_s = (number(row[f"to_fusion_s_{share}"], 2) for share in ("median", "p95"))
        cause = row["cause"].replace("_", " ") or "no stress"
        table.add_row(cause, row["views"], *map(str, counts), *times_s)
    print_table(table)
