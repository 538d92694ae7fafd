"""The hypotheses of a run, "this is that place", with the truth beside them: to fit and judge beliefs by."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs, Truth
from dslab.experiments.evaluation.relation_audit import RELATION_BOUNDS, RecognisedSide
from dslab.slam.belief.log import LoggedView
from dslab.slam.belief.model import Unseen
from dslab.slam.core.relation import Relation

HYPOTHESES_FILE = "hypotheses.parquet"
_SIGHT = {
    "point": np.int32, "cell": np.uint8, "shown": np.float32, "found": np.uint16, "visible": np.uint16,
    "angle": np.float32, "zoom": np.float32, "centre": np.float32,
}  # fmt: skip


def write_hypotheses(folder: Path, views: Sequence[LoggedView], truth: Truth) -> None:
    """Write ``hypotheses.parquet``, see :func:`hypotheses`."""
    hypotheses(views, truth).to_parquet(folder / HYPOTHESES_FILE, index=False)


def hypotheses(views: Sequence[LoggedView], truth: Truth) -> pd.DataFrame:
    """A row per view: what supposed the place, whether it is false, and its sight as lists.

    ``false`` is that of the audit of declared relations: the pose of the view among the keyframes around,
    aligned to the truth. Where that cannot be judged it is empty, and ``reason`` says why.
    """
    rows = []
    for view in views:
        map_id, first, place = view.hypothesis
        new = view.relation.new
        false, off, reason = _judged(view.relation, truth)
        rows.append(
            {
                "kind": view.kind, "map": map_id, "supposed_by": first, "place": place,
                "frame": int(new.frames[0]), "stamp_s": float(new.stamps_s[0]),
                "log_odds": view.log_odds, "explored": view.explored, "torn": view.torn,
                "proposes": view.proposes,
                "false": false, "error_over_bound": off, "reason": reason,
            }
            | view.unseen._asdict()
            | {name: getattr(view.sight, name).astype(kind) for name, kind in _SIGHT.items()}
        )  # fmt: skip
    columns = ["kind", "map", "supposed_by", "place", "frame", "stamp_s", "log_odds", *Unseen._fields]
    columns += ["explored", "torn", "proposes", "false", "error_over_bound", "reason", *_SIGHT]
    table = pd.DataFrame(rows, columns=columns)
    return table.astype({"false": "boolean", "error_over_bound": float})


def _judged(relation: Relation, truth: Truth) -> tuple[bool | None, float | None, str]:
    """Whether a view is not where it is supposed to be, its error over its bound, and why if unknown."""
    side, new = RecognisedSide.of(relation, truth, RELATION_BOUNDS), relation.new
    if isinstance(side, Undefined):
        return None, None, side.reason
    if not truth.known[new.frames].all():
        return None, None, "no true pose of the view"
    errors = side.errors(PosePairs(new.frames, new.T_map_cam, truth.T_world_cam[new.frames]), RELATION_BOUNDS)
    return bool(errors.false[0]), float(errors.position_m[0] / errors.bound_m[0]), ""
