"""``dslab compare``."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from dslab.experiments.cli.console import FolderOption, JsonOption, out, print_json_line, print_table


def compare_command(
    folders: Annotated[
        list[Path],
        typer.Argument(
            help="Result folders of runs, or folders that hold some, as a batch's.", metavar="DIR..."
        ),
    ],
    out_dir: FolderOption,
    as_json: JsonOption = False,
) -> None:
    """Compare finished runs: robustness, completeness, errors, breakages, times.

    Runs of one sequence stand side by side, several runs of a system with intervals. Writes index.html, with
    paths, errors over time and stages, and comparison.json. For example:

    `dslab compare out/kitti --out out/kitti-page`

    `dslab compare out/base out/dual --out out/page`
    """
    from dslab.experiments.comparison.compare import PAGE_FILE, compare_runs

    content = compare_runs(folders, out_dir)
    if as_json:
        print_json_line(content)
        return
    print_table(_table(content))
    for sequence in content["sequences"]:
        for system in sequence["systems"]:
            out.print(f"{sequence['name']}, {system['name']}: {system['audit']}", markup=False)
    out.print(f"page  {out_dir / PAGE_FILE}", soft_wrap=True)


_HEADERS = {
    "robustness": "robust-\nness",
    "completeness": "com-\nplete",
    "ate_m": "ATE\nm",
    "rpe_m": "RPE\nm per s",
    "breakages": "break-\nages",
    "cpu_ms_median": "CPU ms\nper frame",
}


def _table(content: dict[str, Any]) -> Table:
    table = Table(title="means over the runs, half the 95 % interval of the mean")
    for header in ("", "runs", *_HEADERS.values()):
        table.add_column(header, justify="right" if header else "left")
    for sequence in content["sequences"]:
        table.add_section()
        table.add_row(Text(sequence["name"], "bold"))
        for system in sequence["systems"]:
            figures = (_cell(system["figures"][name]) for name in _HEADERS)
            table.add_row(system["name"], str(system["runs"]), *figures)
    return table


def _cell(spread: dict[str, Any]) -> str:
    if spread["mean"] is None:
        return "-"
    text = f"{spread['mean']:.3g}"
    return text if spread["low"] is None else f"{text}\n±{spread['high'] - spread['mean']:.2g}"
