"""Fast rotation: a swing out and back, added to the motion."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.spec import FastRotation
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, drawn, one_of, uniform
from dslab.sim.motion.base import Motion

# The camera's x is right, y down, z forward: a yaw to the right, a pitch upward, a roll to the right.
AXES = {"yaw": (0.0, 1.0, 0.0), "pitch": (1.0, 0.0, 0.0), "roll": (0.0, 0.0, 1.0)}
# max of sin^3(x) cos(x), at tan(x)^2 = 3
PEAK = 3 * np.sqrt(3) / 16
FELT_SHARE = 0.1


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
    sample = drawn(rate_degps=uniform(40, 400), axis=one_of(*AXES))

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
