"""Onset: when does a map become wrong, and how long before the loss? A kind of experiment on claims.

A unit is one world in one condition, run by one system up to its first breakage. An observer outside of the
system holds every step of the map against exact depth and pose. The rows have figures without a verdict:
what is wrong or unusual is decided over all rows, as it depends on what is seen without stress.
"""

import json
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from pydantic import Field

from dslab.experiments.claims.onset.watch import MapWatch, StepJudge, live_errors
from dslab.experiments.claims.spec import SYSTEMS_WITH_POINTS, ClaimSpec, Row, SystemsWithPoints, Unit
from dslab.experiments.eq1.records import SHAM
from dslab.experiments.eq1.trial import frames_of
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit import audit_loss
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.execution import SystemFactory, live_trajectories, slam_camera, system_factory
from dslab.sim.depth_thumbnails import depth_renderer
from dslab.sim.frame_plan import ideal_camera, taking_intrinsics
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage, MapDropped
from dslab.slam.core.results import TrackingResult

UNIT, STEP = "unit", "step"
"""Kinds of rows: what came of a unit, and one per step of its map."""
VOID, HELD, BROKE = "void", "held", "broke"
LEAD_IN_S = 1.0
"""Least time that a map has been tracked when the stress begins, as in the units of Eq. 1."""
_DIGITS = 4
_ROUNDING_S = 1e-6


class OnsetSpec(ClaimSpec):
    """The spec of an experiment on when maps become wrong."""

    kind: Literal["onset"]  # pyright: ignore[reportIncompatibleVariableOverride]
    systems: SystemsWithPoints = SYSTEMS_WITH_POINTS
    unusual: float = Field(
        3.0,
        gt=0,
        description="times the spread of other worlds without stress, the median of their 95 % quantiles, "
        "beyond which a map is unusual; it is wrong beyond the bounds of the audit",
    )
    before_s: tuple[float, ...] = Field(
        (0.1, 0.5, 1.0), min_length=1, description="least delays that are told"
    )
    just_before_s: float = Field(0.5, gt=0, description="before an end, in which the live pose is looked at")
    placebo_times: int = Field(20, ge=1, description="random ends in every unstressed unit")


def units(spec: OnsetSpec) -> list[Unit]:
    """World by world, every condition with every system; a world has one seed of SLAM."""
    return [
        {
            "world": world,
            "condition": condition,
            "base": cell.base,
            "stress": SHAM if cell.degradation is None else spec.degradations[cell.degradation].label,
            "system": system,
            "seed": spec.seed("onset", cell.base, world),
        }
        for world in range(spec.worlds)
        for condition, cell in spec.cells.items()
        for system in spec.systems
    ]


def measure(spec: OnsetSpec, unit: Unit) -> list[Row]:
    """Rows of a unit: that of what came of it, and one per step of its map."""
    cv2.setNumThreads(1)
    scenario = spec.scenario(unit["condition"], unit["world"])
    sequence = frames_of(scenario, 0)
    camera = ideal_camera(taking_intrinsics(scenario.camera))
    with depth_renderer(scenario, camera) as depth_of:
        truth = Truth.of(sequence)
        judge = StepJudge(truth, camera, lambda frame: depth_of(truth.T_world_cam[frame]))
        rows = watched(unit, sequence, judge, spec.lead_in_s, system_factory())
    rows[0] |= {"world_seed": scenario.seed_of_world, "sequence_seed": scenario.seed}
    return rows


def watched(
    unit: Unit, sequence: Sequence, judge: StepJudge, stressed_s: float, build: SystemFactory
) -> list[Row]:
    """Run a unit's system to the first breakage, and judge its map.

    Args:
        unit: its system and seed are used.
        sequence: the frames.
        judge: the truth about them.
        stressed_s: when stress may begin.
        build: makes the system.

    Returns:
        The row of the unit: ``outcome``, with ``void_reason``; ``exposed``, whether the stress acted, None
        without one; frames of the stress' beginning, of the last frame that was fed, of the loss as declared
        and of the true loss, None where it was not lost or that could not be judged; times of the frames, and
        per frame of the stressed map the state, inliers and errors of :func:`live_errors`, as text. Behind
        it those of :meth:`StepJudge.figures` of that map.
    """
    onset = int(np.searchsorted(sequence.stamps_s, stressed_s - _ROUNDING_S))
    system = build(unit["system"], slam_camera(sequence.camera), unit["seed"])
    watch, ended = MapWatch(), None
    for index, stamp_s in enumerate(sequence.stamps_s):
        image = sequence.frames[index]
        watch.frame(image, system.process(image, float(stamp_s)), system)
        lost = [e for e in system.events if isinstance(e, Breakage | MapDropped) and e.frame == index]
        if lost and (index >= onset or isinstance(lost[0], Breakage)):
            ended = lost[0]
            break
    system.finish()
    results = watch.results
    exposed = [segment.first_frame >= 0 for segment in sequence.segments]
    row: Row = {
        "row_kind": UNIT,
        "outcome": HELD if ended is None else BROKE,
        "void_reason": _void_reason(results, onset, sequence.stamps_s),
        "exposed": int(any(exposed)) if exposed else None,
        "stress_frame": onset,
        "last_frame": len(results) - 1,
        "declared_frame": None if ended is None else ended.frame,
        "declared_reason": "" if ended is None else ended.reason,
        "true_loss_frame": None,
    }
    if row["void_reason"]:
        return [row | {"outcome": VOID}]
    map_id = results[onset - 1].map_id
    loss = audit_loss(live_trajectories(results)[map_id], judge.truth, onset, len(results) - 1)
    row["true_loss_frame"] = None if isinstance(loss, Undefined) else loss.true_loss_frame
    steps = [step for step in watch.steps if step.map_id == map_id]
    figures = [judge.figures(step) for step in steps]
    scales = [figure["metres_per_unit"] for figure in figures]
    series = live_errors(results, steps, scales, judge.truth)
    row |= {name: _text(values) for name, values in series.items()}
    row["inliers"] = _text([result.inliers if result.map_id == map_id else None for result in results])
    row["states"] = "".join(str(result.state)[0] for result in results)
    row["stamps_s"] = _text([float(stamp_s) for stamp_s in sequence.stamps_s[: len(results)]])
    return [row, *({"row_kind": STEP, **figure} for figure in map(_rounded, figures))]


def record_unit(spec: OnsetSpec, unit: Unit, path: Path) -> None:
    """Run a unit's system to the end of the footage, and write a recording for ``dslab view``."""
    from dslab.experiments.recording import Recording
    from dslab.experiments.runs.systems.registry import OwnSystem
    from dslab.experiments.runs.systems.run import run_system

    sequence = frames_of(spec.scenario(unit["condition"], unit["world"]), 0)
    with Recording(path, sequence, [unit["system"]]) as recorded:
        watcher = recorded.watch(unit["system"])
        recorded.finish([run_system(OwnSystem(unit["system"]), sequence, unit["seed"], observer=watcher)])


def read_series(row: Row, name: str) -> np.ndarray:
    """A series of a unit's row, a value per frame, NaN for none."""
    return np.array(json.loads(row[name]), float)


def _void_reason(results: list[TrackingResult], onset: int, stamps_s: np.ndarray) -> str:
    """Why there is no map to look at when the stress begins; empty if there is."""
    if len(results) <= onset:
        return "broke in the lead-in"
    if not is_tracked(results[onset - 1]):
        return "not tracking when the stress begins"
    map_id = results[onset - 1].map_id
    since = min(r.frame for r in results if is_tracked(r) and r.map_id == map_id)
    tracked_s = stamps_s[onset - 1] - stamps_s[since]
    return "" if tracked_s >= LEAD_IN_S else f"tracked for {tracked_s:.2f} s only when the stress begins"


def _text(values: list[Any]) -> str:
    rounded = _rounded(dict(enumerate(values))).values()
    return json.dumps(list(rounded), separators=(",", ":"))


def _rounded(row: dict[Any, Any]) -> dict[Any, Any]:
    return {key: round(v, _DIGITS) if isinstance(v, float) else v for key, v in row.items()}
