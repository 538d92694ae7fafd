"""Result folders of runs, read again."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.comparison.left_summary import read_summary
from dslab.experiments.evaluation.metrics import PosePairs
from dslab.experiments.result_folder import SUMMARY_FILE, TRUTH_FILE
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import read_text
from dslab.sim.io.truth import read_tum_poses

_TOLERANCE_S = 1e-3
_MOST_BYTES = 1_000_000_000


@dataclass(frozen=True)
class LeftRun:
    """A run, from its result folder.

    Attributes:
        folder: where it lies.
        sequence, system: names.
        stamps_s: (N,) times of the frames with truth.
        T_world_cam: (N, 4, 4) their true poses.
        pairs: poses of the main map among them.
        summary: of ``summary.json``.
    """

    folder: Path
    sequence: str
    system: str
    stamps_s: np.ndarray
    T_world_cam: np.ndarray
    pairs: PosePairs
    summary: dict[str, Any]


def find_runs(folders: list[Path]) -> list[LeftRun]:
    """Read every result folder in folders, at any depth, in their order.

    Raises:
        InputError: a folder holds none, or one is not complete or has no ground truth.
    """
    found: dict[Path, LeftRun] = {}
    for folder in folders:
        summaries = sorted(folder.rglob(SUMMARY_FILE)) if folder.is_dir() else []
        if not summaries:
            remedy = "name result folders of `dslab run` or `dslab batch`"
            raise InputError(str(folder), f"holds no {SUMMARY_FILE}", remedy)
        for path in summaries:
            found.setdefault(path.parent.resolve(), read_run(path.parent))
    return list(found.values())


def read_run(folder: Path) -> LeftRun:
    """Read a result folder.

    Raises:
        InputError: it is not complete, or has no ground truth.
    """
    summary = read_summary(folder)
    truth_file = folder / TRUTH_FILE
    if not truth_file.is_file():
        problem = f"holds no {TRUTH_FILE}: the sequence has no ground truth"
        raise InputError(str(folder), problem, "leave it out, or run it again")
    stamps_s = _stamps_s(truth_file)
    truth = read_tum_poses(truth_file, stamps_s, _TOLERANCE_S)
    path = folder / "trajectory.txt"
    poses = read_tum_poses(path, stamps_s, _TOLERANCE_S) if path.is_file() and len(_stamps_s(path)) else None
    if truth is None:
        raise InputError(str(truth_file), "holds no pose", "run it again")
    frames = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))) if poses is not None else np.zeros(0, int)
    placed = poses[frames] if poses is not None else np.zeros((0, 4, 4))
    pairs = PosePairs(frames, placed, truth[frames])
    return LeftRun(folder, summary["sequence"], summary["system"], stamps_s, truth, pairs, summary)


def _stamps_s(path: Path) -> np.ndarray:
    text = read_text(path, _MOST_BYTES)
    lines = (line.split() for line in text.splitlines() if line.strip() and not line.startswith("#"))
    try:
        return np.array([float(words[0]) for words in lines])
    except ValueError:
        raise InputError(str(path), "has a row without a stamp", "run it again") from None
