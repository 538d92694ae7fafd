"""The systems of a batch beside its first one, run by run, on the frames that both have placed."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dslab.experiments.batch.rows import Row
from dslab.experiments.comparison.left_runs import read_run
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs
from dslab.experiments.result_folder import TRUTH_FILE

PAIRS_FILE = "pairs.csv"


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
    for _, own in rows[rows.folder.notna()].groupby(["source", "run"], sort=False):
        source, run = own.source.iloc[0], int(own.run.iloc[0])
        if own.system.nunique() < 2 or not all(
            (folder / place / TRUTH_FILE).is_file() for place in own.folder
        ):
            continue
        first, *others = [(row.system, read_run(folder / row.folder)) for row in own.itertuples()]
        path_m = metrics.path_length_m(first[1].T_world_cam)
        found += [
            {"source": source, "run": run, "system": system, "path_m": path_m}
            | _compared(other.pairs, first[1].pairs)
            for system, other in others
        ]
    return pd.DataFrame(found)


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
