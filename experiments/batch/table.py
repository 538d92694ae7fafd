"""A batch in short: medians per sequence and system, and every system beside the first one."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dslab.experiments.batch.rows import DOSE, ERROR
from dslab.experiments.comparison.left_runs import read_run
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs
from dslab.experiments.result_folder import TRUTH_FILE
from dslab.experiments.runs.ending import EndKind

PAIRS_FILE = "pairs.csv"
_DRAWS = 4000
MEDIANS = (
    "keyframe_ate_m", "ate_m", "rpe_m", "completeness", "scale_first_over_last", "cpu_ms_median",
    "cpu_s", "wall_s",
)  # fmt: skip


def sums(rows: pd.DataFrame) -> pd.DataFrame:
    """Sum up the rows of :func:`experiments.batch.run.run_batch`.

    Returns:
        Per ``source``, ``dose`` and ``system``: ``runs`` that were made, ``errors`` that were not, ``intact``
        maps, ``ended_badly``, ``breakages`` declared (missing if the system declares nothing), the sums of
        all that was ``declared`` where there is a truth, of this ``false`` and ``unjudged``, and medians of
        MEDIANS over the runs that have the figure.
    """
    groups = rows.groupby(["source", DOSE, "system"], sort=False, dropna=False)
    return pd.DataFrame([_sum(own) for _, own in groups])


def _sum(own: pd.DataFrame) -> dict[str, Any]:
    made = own[own.ended != ERROR]
    says = made[made.declares.fillna("nothing") != "nothing"]
    return {
        **{name: own[name].iloc[0] for name in ("source", "sequence", DOSE, "system")},
        "runs": len(made),
        "errors": len(own) - len(made),
        "intact": int(made.intact.fillna(False).sum()),
        "ended_badly": int((made.ended != EndKind.FINISHED.value).sum()),
        "breakages": int(says.breakages.sum()) if len(says) else None,
        **{part: int(made.filter(regex=f"^{part}_").sum(axis=None)) for part in ("declared", "false")},
        "unjudged": int(made.unjudged.sum()),
        **{name: _median_of(made[name]) for name in MEDIANS},
    }


def _median_of(values: pd.Series) -> float | None:
    known = values.dropna()
    return float(known.median()) if len(known) else None


def pairs(rows: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """Compare every run with that of the batch's first system over the same frames.

    ATE of two systems compares only over common frames: one that is lost early has little to be wrong about.

    Args:
        rows: of :func:`experiments.batch.run.run_batch`.
        folder: of the batch.

    Returns:
        Per ``source``, ``dose``, ``run`` and further ``system``: ``ate_poses`` of its main map and
        ``first_ate_poses`` of the first system's, ``common_poses`` of both, over these ``common_ate_m`` and
        ``first_common_ate_m``, None where undefined, ``cpu_ms_median`` and ``first_cpu_ms_median`` of all
        frames, and ``true_path_m``. Empty for one system, or where no sequence has a truth.
    """
    found: list[dict[str, Any]] = []
    for _, own in rows[rows.folder.notna()].groupby(["source", DOSE, "run"], sort=False, dropna=False):
        source, run = own.source.iloc[0], int(own.run.iloc[0])
        if own.system.nunique() < 2 or not all(
            (folder / place / TRUTH_FILE).is_file() for place in own.folder
        ):
            continue
        first, *others = [(row, read_run(folder / str(row.folder))) for row in own.itertuples()]
        path_m = metrics.path_length_m(first[1].T_world_cam)
        found += [
            {
                "source": source,
                DOSE: own[DOSE].iloc[0],
                "run": run,
                "system": row.system,
                "true_path_m": path_m,
            }
            | {"cpu_ms_median": row.cpu_ms_median, "first_cpu_ms_median": first[0].cpu_ms_median}
            | _compared(other.pairs, first[1].pairs)
            for row, other in others
        ]
    return pd.DataFrame(found)


def beside_first(found: pd.DataFrame) -> pd.DataFrame:
    """Sum up :func:`pairs`: every system over the first one.

    Returns:
        Per ``system`` and ``figure``: ``runs`` in which the ratio is known, their ``median``, ``min`` and
        ``max``, and the ``mean`` over the sequences with its bounds of 95 %, ``low`` and ``high``. Every
        sequence with its dose weighs the same. Means of ATE and CPU are geometric, that of frames is
        arithmetic. The bounds are of a bootstrap that draws sequences, and runs in each.
    """
    rows: list[dict[str, Any]] = []
    for system, own in found.groupby("system", sort=False):
        for figure, over, under, log in (
            ("frames in the main map", "ate_poses", "first_ate_poses", False),
            ("ATE on common frames", "common_ate_m", "first_common_ate_m", True),
            ("CPU of tracking", "cpu_ms_median", "first_cpu_ms_median", True),
        ):
            ratio = (own[over].astype(float) / own[under].astype(float)).replace(np.inf, np.nan)
            if log:
                ratio = ratio.replace(0.0, np.nan)
            known = own[["source", DOSE]].assign(value=np.log(ratio) if log else ratio).dropna(subset="value")
            groups = [g.value.to_numpy() for _, g in known.groupby(["source", DOSE], dropna=False)]
            mean, low, high = np.exp(_mean_of(groups)) if log else _mean_of(groups)
            ratio = ratio.dropna()
            row = {"runs": len(ratio), "median": ratio.median(), "mean": mean, "low": low, "high": high}
            rows.append({"system": system, "figure": figure, **row, "min": ratio.min(), "max": ratio.max()})
    return pd.DataFrame(rows)


def _mean_of(groups: list[np.ndarray]) -> np.ndarray:
    """Mean of the means of groups of runs, and bounds of 95 %; NaN without any."""
    if not groups:
        return np.full(3, np.nan)
    rng, n = np.random.default_rng(0), len(groups)
    drawn = [
        np.mean([rng.choice(groups[g], len(groups[g])).mean() for g in rng.integers(n, size=n)])
        for _ in range(_DRAWS)
    ]
    return np.array([np.mean([g.mean() for g in groups]), *np.quantile(drawn, (0.025, 0.975))])


def _compared(own: PosePairs, first: PosePairs) -> dict[str, Any]:
    common = np.intersect1d(own.frames, first.frames)
    return {
        "ate_poses": len(own),
        "first_ate_poses": len(first),
        "common_poses": len(common),
        "common_ate_m": _ate_m(own.where(np.isin(own.frames, common))),
        "first_common_ate_m": _ate_m(first.where(np.isin(first.frames, common))),
    }


def _ate_m(placed: PosePairs) -> float | None:
    found = metrics.ate(placed) if len(placed) else Undefined("no pose")
    return None if isinstance(found, Undefined) else found.rmse_m
