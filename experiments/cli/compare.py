"""``dslab compare``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from dslab.experiments.cli.console import FolderOption, JsonOption, out, print_json_line, print_rows, say

_FIGURES = {
    "robustness": "robust-\nness",
    "completeness": "com-\nplete",
    "path_share": "path\nshare",
    "ate_m": "ATE\nm",
    "rpe_m": "RPE\nm per s",
    "breakages": "break-\nages",
    "cpu_ms_median": "CPU ms\nper frame",
}


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

    Runs of one input stand side by side, several runs of a system with intervals. An input is its images,
    times, camera, truth and stress, whatever its name. Inputs that differ in a dose are shown against it
    too. Writes index.html, with paths, errors over time and stages, and comparison.json. For example:

    `dslab compare out/kitti --out out/kitti-page`
    """
    from dslab.experiments.cli.run_tables import INTERVALS, dose_row
    from dslab.experiments.comparison.page import PAGE_FILE, compare_runs

    content = compare_runs(folders, out_dir)
    if as_json:
        print_json_line(content)
        return
    out.print("means over the runs, and 95 % intervals: none of one run, or of runs that are all alike")
    for sequence in content["sequences"]:
        print_rows(_rows(sequence), sequence["name"])
    for series in content["dose_series"]:
        print_rows(map(dose_row, series["points"]), f"against the dose, {INTERVALS}: {series['axis']}")
    for sequence in content["sequences"]:
        audits: dict[str, list[str]] = {}
        for system in sequence["systems"]:
            audits.setdefault(system["audit"], []).append(system["name"])
        for said, systems in audits.items():
            say(f"{sequence['name']}, {', '.join(systems)}: {said}")
    say(f"page  {out_dir / PAGE_FILE}")


def _rows(sequence: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for system in sequence["systems"]:
        yield _row(system["name"], system["runs"], system["figures"], "mean")
        if any(system["figures"][name]["low"] is not None for name in _FIGURES):
            yield _row("  from", "", system["figures"], "low")
            yield _row("  to", "", system["figures"], "high")


def _row(name: str, runs: int | str, figures: dict[str, Any], part: str) -> dict[str, Any]:
    from dslab.experiments.comparison.figures import WRITTEN
    from dslab.experiments.comparison.page import figure_text

    found = {title: (figures[of][part], WRITTEN[of]) for of, title in _FIGURES.items()}
    cells = {title: None if value is None else figure_text(value, of) for title, (value, of) in found.items()}
    return {"": name, "runs": runs, **cells}
