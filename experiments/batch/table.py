"""A batch in short: a row per sequence and system, medians over its runs."""

from typing import Any

import pandas as pd

from dslab.experiments.batch.rows import ERROR
from dslab.experiments.runs.ending import EndKind

MEDIANS = ("ate_keyframes_m", "ate_frames_m", "rpe_m", "completeness", "cpu_ms_median", "wall_s")


def sums(rows: pd.DataFrame) -> pd.DataFrame:
    """Sum up the rows of :func:`experiments.batch.run.run_batch`.

    Returns:
        Per ``source`` and ``system``: ``runs`` that were made, ``errors`` that were not, ``intact`` maps,
        ``ended_badly``, ``breakages`` declared (missing if the system declares nothing), and medians of
        MEDIANS over the runs that have the figure.
    """
    groups = rows.groupby(["source", "system"], sort=False)
    return pd.DataFrame([_sum(own) for _, own in groups])


def _sum(own: pd.DataFrame) -> dict[str, Any]:
    made = own[own.ended != ERROR]
    says = made[made.declares.fillna("nothing") != "nothing"]
    return {
        **{name: own[name].iloc[0] for name in ("source", "sequence", "system")},
        "runs": len(made),
        "errors": len(own) - len(made),
        "intact": int(made.intact.fillna(False).sum()),
        "ended_badly": int((made.ended != EndKind.FINISHED.value).sum()),
        "breakages": int(says.breakages.sum()) if len(says) else None,
        **{name: _median_of(made[name]) for name in MEDIANS},
    }


def _median_of(values: pd.Series) -> float | None:
    known = values.dropna()
    return float(known.median()) if len(known) else None
