"""Rotation of the camera: a swing out and back on top of the motion, or on the spot, without parallax."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.segments import FastRotation, PureRotation
from dslab.sim.degradations.base import Degradation, FramePlan, Stage
from dslab.sim.motion.base import Motion

# The camera's x is right, y down, z forward: a yaw to the right, a pitch upward, a roll to the right.
AXES = {"yaw": (0.0, 1.0, 0.0), "pitch": (1.0, 0.0, 0.0), "roll": (0.0, 0.0, 1.0)}
# max of sin^3(x) cos(x), at tan(x)^2 = 3
PEAK = 3 * np.sqrt(3) / 16
FELT_SHARE = 0.1
# Share of the segment for braking at its start, and for setting off at its end.
BRAKING = 0.15


@dataclass(frozen=True)
class SwungMotion:
    """A motion with a swing about one camera axis, thrice continuously differentiable.

    The swing's angle is ``a sin(pi u)^4`` with ``u`` from 0 to 1 over the segment: angle and rate are zero
    at both ends.

    Attributes:
        base: the motion without the swing.
        axis: (3,) unit vector, camera frame.
        start_s, duration_s: the swing's time.
        peak_radps: its peak angular rate.
    """

    base: Motion
    axis: np.ndarray
    start_s: float
    duration_s: float
    peak_radps: float

    def T_world_cam(self, stamp_s: float | np.ndarray) -> np.ndarray:
        T = self.base.T_world_cam(stamp_s).copy()
        T[..., :3, :3] = T[..., :3, :3] @ self._swing(stamp_s)
        return T

    def velocity_mps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """See ``Motion``: the swing is about the camera's centre."""
        return self.base.velocity_mps(stamp_s)

    def rate_radps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        carried = np.einsum("...ji,...j->...i", self._swing(stamp_s), self.base.rate_radps(stamp_s))
        return carried + self.swing_rate_radps(stamp_s)[..., None] * self.axis

    def swing_rate_radps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """(...) signed rate of the swing alone about its axis."""
        x = self._phase(stamp_s)
        return self.peak_radps / PEAK * np.sin(x) ** 3 * np.cos(x)

    def _swing(self, stamp_s: float | np.ndarray) -> np.ndarray:
        amplitude = self.peak_radps * self.duration_s / (4 * np.pi * PEAK)
        angle = amplitude * np.sin(self._phase(stamp_s)) ** 4
        return Rotation.from_rotvec(angle[..., None] * self.axis).as_matrix()

    def _phase(self, stamp_s: float | np.ndarray) -> np.ndarray:
        u = np.clip((np.asarray(stamp_s, float) - self.start_s) / self.duration_s, 0, 1)
        return np.pi * u


class FastRotationDegradation(Degradation[FastRotation]):
    """Swings the camera out and back."""

    kind = "fast_rotation"
    stage = Stage.MOTION
    measure_name = "swing_degps"

    def apply(self, plan: FramePlan, segment: FastRotation) -> FramePlan:
        return replace(plan, motion=_swung(plan.motion, segment))

    def measure(self, plan: FramePlan, segment: FastRotation, blur_px: np.ndarray) -> np.ndarray:
        """(N,) angular rate of the swing alone, without the path's own, deg/s."""
        return np.abs(np.rad2deg(_swung(plan.motion, segment).swing_rate_radps(plan.stamps_s)))

    def threshold(self, segment: FastRotation) -> float:
        """A tenth of the peak rate; at the turning point the rate passes through zero."""
        return FELT_SHARE * segment.rate_degps


def swing_axis(segment: FastRotation) -> np.ndarray:
    """(3,) unit vector, camera frame."""
    return np.array(AXES[segment.axis])


def swing_angle_rad(segment: FastRotation) -> float:
    """Angle of the swing at its turning point."""
    return np.deg2rad(segment.rate_degps) * segment.duration_s / (4 * np.pi * PEAK)


def _swung(base: Motion, segment: FastRotation) -> SwungMotion:
    peak_radps = np.deg2rad(segment.rate_degps)
    return SwungMotion(base, swing_axis(segment), segment.start_s, segment.duration_s, peak_radps)


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
