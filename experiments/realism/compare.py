"""From names of sequences to a folder with the comparison."""

import json
from collections.abc import Callable
from collections.abc import Sequence as Many
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.realism.comparison import footage_content
from dslab.experiments.realism.footage import Footage, measure_footage
from dslab.experiments.realism.page import footage_html
from dslab.experiments.runs.files import plain
from dslab.experiments.runs.sources import open_sequence
from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import check_free, new_directory

PAGE_FILE, FIGURES_FILE = "index.html", "footage.json"

Progress = Callable[[str, int, int], None]


def compare_footage(
    sources: Many[str],
    out_dir: Path,
    seed: int | None = None,
    frames: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure every sequence and write the page and its figures.

    Args:
        sources: names as ``open_sequence`` takes them, each once; the first is the reference.
        out_dir: absent or empty.
        seed: root seed of scenarios and system; None for the scenario's own, and 0.
        frames: only so many of each, from the first on; None for all.
        progress: called with (step, frames done, frames in all).

    Returns:
        The figures, as in ``footage.json``.

    Raises:
        InputError: a source is not valid or named twice, or the folder cannot be written.
    """
    twice = [source for place, source in enumerate(sources) if source in sources[:place]]
    if twice:
        raise InputError(twice[0], "is named twice", "name each sequence once")
    check_free(out_dir)
    footage = [_measured(source, seed, frames, progress) for source in sources]
    content = plain(footage_content(_named_apart(footage, sources)))
    with new_directory(out_dir) as folder:
        (folder / PAGE_FILE).write_text(footage_html(content), encoding="utf-8")
        text = json.dumps(content, indent=1, allow_nan=False)
        (folder / FIGURES_FILE).write_text(text + "\n", encoding="utf-8")
    return content


def _measured(source: str, seed: int | None, frames: int | None, progress: Progress | None) -> Footage:
    sequence = open_sequence(source, seed, progress)
    if frames is not None and frames < len(sequence):
        sequence = sequence.only(np.arange(frames))
    own = seed if seed is not None else int(sequence.meta.get("seed", 0))
    step = f"tracking {sequence.name}"
    return measure_footage(
        sequence, own, (lambda done, total: progress(step, done, total)) if progress else None
    )


def _named_apart(footage: Many[Footage], sources: Many[str]) -> list[Footage]:
    """Footage whose names tell it apart: where two are named alike, the sources' own names."""
    names = [f.name for f in footage]
    return [
        f if names.count(f.name) == 1 else Footage(source, f.values, f.figures, f.scale_along)
        for f, source in zip(footage, sources, strict=True)
    ]
