"""When a map became wrong: the rule, on the figures of its steps alone."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from dslab.experiments.claims.onset.watch import BACK
from dslab.experiments.evaluation.audit import BOUNDS
from dslab.experiments.evaluation.metrics import PoseBounds

CAUSES = ("points", "poses", "scale")
Step = Mapping[Any, Any]
"""The figures of a step, see :meth:`experiments.claims.onset.watch.StepJudge.figures`."""
_QUANTILE = 0.95


@dataclass(frozen=True)
class StepBounds:
    """Bounds beyond which a step of a map is wrong; those of the audit, where it has one, by default.

    Attributes:
        points: median relative depth error of new points. The audit has none of depths: it is that of scale.
        scale: change of the local scale since the first seconds, a factor of 1 plus this either way.
        pose: of the newest keyframe relative to the furthest one back, over the true path between the two.
    """

    points: float = BOUNDS.scale_share
    scale: float = BOUNDS.scale_share
    pose: PoseBounds = BOUNDS


@dataclass(frozen=True)
class Onset:
    """Since when a map is wrong, at an end.

    Attributes:
        frame: of the first step from which all are wrong to the end; None if the last one is right.
        cause: what was out of bounds there, of ``CAUSES``, joined by ``+``; empty without.
    """

    frame: int | None
    cause: str


def causes(step: Step, bounds: StepBounds) -> tuple[str, ...]:
    """What of a step is out of bounds; what is undetermined is not."""
    found = _errors(step)
    position_m = found["walked"] and bounds.pose.position_m(found["walked"])
    poses = step["unfit"] or _beyond(found["offset"], position_m)
    wrong = (
        _beyond(found["points"], bounds.points),
        poses or _beyond(found["rotation"], bounds.pose.rotation_deg),
        _beyond(found["scale"], bounds.scale),
    )
    return tuple(name for name, is_wrong in zip(CAUSES, wrong, strict=True) if is_wrong)


def onset(steps: Iterable[Step], end_frame: int, bounds: StepBounds) -> Onset:
    """Since when a map is wrong at an end: the loss, or any time.

    Args:
        steps: in order.
        end_frame: steps up to it count.
        bounds: of a right step.
    """
    found = Onset(None, "")
    for step in steps:
        if step["frame"] > end_frame:
            break
        if named := causes(step, bounds):
            found = found if found.frame is not None else Onset(int(step["frame"]), "+".join(named))
        else:
            found = Onset(None, "")
    return found


def unusual_bounds(unstressed: Sequence[Sequence[Step]], times: float) -> StepBounds | None:
    """Bounds at a multiple of what maps show without stress.

    Args:
        unstressed: the steps of units without stress, of other worlds than the one to be judged.
        times: the multiple, of the median over the units of the 95 % quantile over the steps of each.

    Returns:
        The bounds; None if one of the errors is determined in no unit.
    """

    def usual(name: str, per: str = "") -> float:
        found = []
        for errors in ([_errors(step) for step in steps] for steps in unstressed):
            pairs = [(e[name], e[per] if per else 1.0) for e in errors]
            known = [value / of for value, of in pairs if value is not None and of]
            if known:
                found.append(np.quantile(known, _QUANTILE))
        return times * float(np.median(found)) if found else np.nan

    share, rotation_deg = usual("offset", "walked"), usual("rotation")
    made = StepBounds(usual("points"), usual("scale"), PoseBounds(share, 0.0, rotation_deg))
    return made if np.isfinite([made.points, made.scale, share, rotation_deg]).all() else None


def _errors(step: Step) -> dict[str, float | None]:
    """The errors of a step on which it is judged, those of its pose over the widest baseline."""

    def known(name: str) -> float | None:
        value = step[name]
        return float(value) if value is not None and isfinite(value) else None

    ratio = known("scale_ratio")
    widest = next((back for back in reversed(BACK) if known(f"offset{back}_m") is not None), BACK[0])
    return {
        "points": known("depth_error"),
        "scale": max(ratio, 1 / ratio) - 1 if ratio else None,
        "offset": known(f"offset{widest}_m"),
        "walked": known(f"walked{widest}_m"),
        "rotation": known(f"rotation{widest}_deg"),
    }


def _beyond(value: float | None, bound: Any) -> bool:
    return value is not None and bound is not None and value > bound
