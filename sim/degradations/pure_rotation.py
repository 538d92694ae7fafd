"""Pure rotation: the camera stops and turns on the spot, without parallax."""

from dataclasses import dataclass, replace

import numpy as np

from dslab.scenarios.segments import PureRotation
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, drawn, one_of, uniform
from dslab.sim.degradations.fast_rotation import AXES, PEAK, SwungMotion
from dslab.sim.motion.base import Motion

FELT_SHARE = 0.1
# Share of the segment for braking at its start, and for setting off at its end.
BRAKING = 0.15


@dataclass(frozen=True)
class PausedMotion:
    """A motion with a pause, twice continuously differentiable.

    Attributes:
        base: the motion without the pause.
        start_s, duration_s: from the start of braking until full pace is reached again.
        braking_s: time of braking, and of setting off.
        from_rest: the motion starts at rest, without braking.
    """

    base: Motion
    start_s: float
    duration_s: float
    braking_s: float
    from_rest: bool = False

    def T_world_cam(self, stamp_s: float | np.ndarray) -> np.ndarray:
        return self.base.T_world_cam(self._own_time_s(stamp_s))

    def velocity_mps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        return self.pace(stamp_s)[..., None] * self.base.velocity_mps(self._own_time_s(stamp_s))

    def rate_radps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        return self.pace(stamp_s)[..., None] * self.base.rate_radps(self._own_time_s(stamp_s))

    def pace(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """(...) share of the motion's own pace: 1 before and after, 0 at rest."""
        into, off = self._phases(stamp_s)
        return (0.0 if self.from_rest else 1 - _smooth(into)) + _smooth(off)

    def _phases(self, stamp_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        since_s = np.asarray(stamp_s, float) - self.start_s
        return since_s / self.braking_s, (since_s - self.duration_s) / self.braking_s + 1

    def _own_time_s(self, stamp_s: float | np.ndarray) -> np.ndarray:
        into, off = self._phases(stamp_s)
        if self.from_rest:
            return self.start_s + self.braking_s * _smooth_area(off)
        return np.asarray(stamp_s, float) - self.braking_s * (_smooth_area(into) - _smooth_area(off))


def _smooth(u: np.ndarray) -> np.ndarray:
    """Smooth step from (0, 0) to (1, 1) with zero slope at both ends."""
    u = np.clip(u, 0, 1)
    return u**3 * (10 - 15 * u + 6 * u**2)


def _smooth_area(u: np.ndarray) -> np.ndarray:
    """The integral of ``_smooth`` from 0."""
    inside = np.clip(u, 0, 1)
    return inside**4 * (2.5 - 3 * inside + inside**2) + np.maximum(u - 1, 0)


class PureRotationDegradation(Degradation[PureRotation]):
    """Stops the camera, turns it about one of its axes and back, and continues.

    The motion after the stop is delayed by its duration. A stop at the first frame starts at rest: the
    sequence has no parallax before the camera sets off.
    """

    kind = "pure_rotation"
    stage = Stage.MOTION
    measure_name = "turn_on_spot_degps"
    sample = drawn(angle_deg=uniform(15, 120), axis=one_of(*AXES))

    def apply(self, plan: FramePlan, segment: PureRotation) -> FramePlan:
        if segment.angle_deg == 0:
            return plan
        braking_s = BRAKING * segment.duration_s
        paused = PausedMotion(
            plan.motion, segment.start_s, segment.duration_s, braking_s, segment.start_s == 0
        )
        return replace(plan, motion=_turned(paused, segment))

    def measure(self, plan: FramePlan, segment: PureRotation, blur_px: np.ndarray) -> np.ndarray:
        """(N,) angular rate of the camera at rest, deg/s."""
        return np.abs(np.rad2deg(_turned(plan.motion, segment).swing_rate_radps(plan.stamps_s)))

    def threshold(self, segment: PureRotation) -> float:
        """A tenth of the peak rate; at the turning point the rate passes through zero."""
        return FELT_SHARE * float(np.rad2deg(_peak_radps(segment)))


def _turn_s(segment: PureRotation) -> float:
    """Time at rest, in which the camera turns, seconds."""
    return (1 - 2 * BRAKING) * segment.duration_s


def _peak_radps(segment: PureRotation) -> float:
    """Peak rate of the swing that reaches the segment's angle."""
    return float(np.deg2rad(segment.angle_deg)) * 4 * np.pi * PEAK / _turn_s(segment)


def _turned(base: Motion, segment: PureRotation) -> SwungMotion:
    start_s = segment.start_s + BRAKING * segment.duration_s
    return SwungMotion(base, np.array(AXES[segment.axis]), start_s, _turn_s(segment), _peak_radps(segment))
