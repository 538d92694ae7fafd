"""``dslab compare``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from dslab.experiments.cli.console import FolderOption, JsonOption, print_json_line, print_rows, say

_FIGURES = {
    "robustness": "robust-\nness",
    "completeness": "com-\nplete",
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

    Runs of one sequence stand side by side, several runs of a system with intervals. Writes index.html, with
    paths, errors over time and stages, and comparison.json. For example:

    `dslab compare out/kitti --out out/kitti-page`
    """
    from dslab.experiments.comparison.page import PAGE_FILE, compare_runs

    content = compare_runs(folders, out_dir)
    if as_json:
        print_json_line(content)
        return
    print_rows(_rows(content), "means over the runs, half the 95 % interval of the mean")
    for sequence in content["sequences"]:
        for system in sequence["systems"]:
            say(f"{sequence['name']}, {system['name']}: {system['audit']}")
    say(f"page  {out_dir / PAGE_FILE}")


def _rows(content: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for sequence in content["sequences"]:
        yield {"": sequence["name"], "runs": "", **dict.fromkeys(_FIGURES.values(), "")}
        for system in sequence["systems"]:
            figures = {title: _cell(system["figures"][name]) for name, title in _FIGURES.items()}
            yield {"": system["name"], "runs": system["runs"], **figures}
        yield {}


def _cell(spread: dict[str, Any]) -> str | None:
    if spread["mean"] is None:
        return None
    text = f"{spread['mean']:.3g}"
    return text if spread["low"] is None else f"{text}\n±{spread['high'] - spread['mean']:.2g}"
