"""From result folders to a folder with the comparison."""

import json
from pathlib import Path
from typing import Any

from dslab.experiments.comparison.figures import comparison_content
from dslab.experiments.comparison.left_runs import find_runs
from dslab.experiments.comparison.page import comparison_html
from dslab.experiments.runs.files import plain
from dslab.sim.io.folders import check_free, new_directory

PAGE_FILE, FIGURES_FILE = "index.html", "comparison.json"


def compare_runs(folders: list[Path], out_dir: Path) -> dict[str, Any]:
    """Compare every run in result folders, and write page and figures.

    Args:
        folders: result folders, or folders that hold some at any depth.
        out_dir: absent or empty.

    Returns:
        The figures, as in ``comparison.json``.

    Raises:
        InputError: a folder holds no run, a run is not complete or has no truth, or ``out_dir`` is taken.
    """
    check_free(out_dir)
    content = comparison_content(find_runs(folders))
    with new_directory(out_dir) as folder:
        (folder / PAGE_FILE).write_text(comparison_html(content), encoding="utf-8")
        figures = plain(content)
        (folder / FIGURES_FILE).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return figures
