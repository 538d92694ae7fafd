"""The systems of a batch beside its first one, run by run, on the frames that both have placed."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.batch.rows import Row
from experiments.evaluation import metrics
from experiments.evaluation.alignment import Undefined
from experiments.evaluation.metrics import PosePairs
from experiments.runs.sources import open_sequence
from sim.io.truth import read_tum_poses

PAIRS_FILE = "pairs.csv"
_TOLERANCE_S = 1e-3


def pairs(rows: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """Compare every run with that of the batch's first system over the same frames.

    ATE of two systems compares only over common frames: one that is lost early has little to be wrong about.

    Args:
        rows: of :func:`experiments.batch.run.run_batch`.
        folder: of the batch.

    Returns:
        Per ``source``, ``run`` and further ``system``: ``posed`` frames of its main map and ``first_posed``
        of the first system's, ``common`` frames, on these ``ate_m`` and ``first_ate_m``, None where
        undefined, and ``path_m``, the length of the true path. Empty for one system, or where no sequence
        has a truth.
    """
    found: list[Row] = []
    for source, own in rows[rows.folder.notna()].groupby("source", sort=False):
        first = own.system.iloc[0]
        if own.system.nunique() < 2:
            continue
        sequence = open_sequence(str(source))
        truth = sequence.T_world_cam
        if truth is None:
            continue
        path_m = metrics.path_length_m(truth[np.isfinite(truth).all(axis=(1, 2))])
        placed = {
            (row.system, row.run): _placed(folder / row.folder, sequence.stamps_s, truth)
            for row in own.itertuples()
        }
        found += [
            {"source": source, "run": run, "system": system, "path_m": path_m}
            | _compared(theirs, placed[first, run])
            for (system, run), theirs in placed.items()
            if system != first and (first, run) in placed
        ]
    return pd.DataFrame(found)


def _placed(run: Path, stamps_s: np.ndarray, truth: np.ndarray) -> PosePairs:
    """What a run has placed in its main map, beside the truth."""
    path = run / "trajectory.txt"
    holds_poses = path.is_file() and any(not line.startswith("#") for line in path.open(encoding="utf-8"))
    poses = read_tum_poses(path, stamps_s, _TOLERANCE_S) if holds_poses else None
    if poses is None:
        poses = np.full((len(stamps_s), 4, 4), np.nan)
    frames = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)) & np.isfinite(truth).all(axis=(1, 2)))
    return PosePairs(frames, poses[frames], truth[frames])


def _compared(own: PosePairs, first: PosePairs) -> dict[str, Any]:
    common = np.intersect1d(own.frames, first.frames)
    return {
        "posed": len(own),
        "first_posed": len(first),
        "common": len(common),
        "ate_m": _ate_m(own.where(np.isin(own.frames, common))),
        "first_ate_m": _ate_m(first.where(np.isin(first.frames, common))),
    }


def _ate_m(placed: PosePairs) -> float | None:
    found = metrics.ate(placed) if len(placed) else Undefined("no pose")
    return None if isinstance(found, Undefined) else found.rmse_m
