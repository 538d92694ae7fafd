"""Motion of the camera from frame to frame: what is expected of the next, and how well it is known.

A Kalman filter holds the error of the pose and of the velocity, twists from frame to frame whose translation
is in usual depths. The velocity is a random walk, so that the pose ahead is known to

    P = F P Fᵀ + (1 1)ᵀ(1 1) ⊗ Q,  F = [1 1; 0 1].

Images say of a pose what their information lets them: A = I / (D σ²), with the variance σ² of the residuals
and D pixels for each independent one. An alignment minimises both costs together, so that it stays where it
is expected in directions in which images tell nothing: turn and shift of a blurred view of alike depths. Its
result updates the velocity, and P ← (P⁻¹ + A)⁻¹.

Q is what the last innovations were, by their median squares, direction by direction.

Source: Kalman, "A New Approach to Linear Filtering and Prediction Problems", 1960; random walks of the
velocity as in Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
Sec. 6.2.
"""

from collections import deque

import numpy as np

from dslab.slam.optimization._se3 import retract
from dslab.slam.optimization.sim3_algebra import log_sim3

SHARED = 5.0
"""D: a point gives its depth to its pixel and to four beside it. Stated and exact poses of frames in rendered
rooms and corridors agree with 4.1 to 5.1."""
_REMEMBERED = 30  # innovations
_FIRST = np.repeat([0.02, 0.02], 3)  # deviation of an innovation before any is known, depths and rad
_LEAST = np.repeat([2e-4, 2e-4], 3)  # deviation of an innovation at least
_OF_MEDIAN = 2.198  # variance of a normal distribution over its median square


class MotionFilter:
    """Expects the next frame's motion.

    Attributes:
        velocity: (6,) twist from frame to frame, its translation in usual depths.
        covariance: (12, 12) of the errors of pose and velocity.
    """

    def __init__(self) -> None:
        self.velocity = np.zeros(6)
        self.covariance = np.zeros((12, 12))
        self.covariance[6:, 6:] = np.diag(_FIRST**2)
        self._innovations: deque[np.ndarray] = deque([_FIRST / np.sqrt(_OF_MEDIAN)] * 5, maxlen=_REMEMBERED)

    def begin(self, T_before: np.ndarray, T_last: np.ndarray, depth: float) -> None:
        """Begin with the motion between two frames, (4, 4) poses."""
        self.velocity = log_twist(T_last @ np.linalg.inv(T_before)) / _units(depth)

    def uncertainty(self, information: np.ndarray) -> float:
        """Largest standard deviation of the next pose, in usual depths and rad, if images say this of it."""
        return float(np.sqrt(np.linalg.eigvalsh(self._updated(information)[:6, :6])[-1]))

    def ahead(self, T_last: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray]:
        """Pose (4, 4) at which the frame after one is expected, and its covariance (6, 6).

        Args:
            T_last: (4, 4) pose of the last frame.
            depth: usual depth.
        """
        T = np.eye(4)
        retract(np.ascontiguousarray(T_last), self.velocity * _units(depth), T)
        return T, self._predicted()[:6, :6]

    def unseen(self) -> float:
        """Largest standard deviation of the next pose, in usual depths and rad, if no image tells of it."""
        return float(np.sqrt(np.linalg.eigvalsh(self._predicted()[:6, :6])[-1]))

    def pass_over(self) -> None:
        """Go on by a frame that tells nothing."""
        self.covariance = self._predicted()

    def _predicted(self) -> np.ndarray:
        F = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(6))
        Q = np.maximum(_OF_MEDIAN * np.median(np.square(self._innovations), axis=0), _LEAST**2)
        return F @ self.covariance @ F.T + np.kron(np.ones((2, 2)), np.diag(Q))

    def take(self, T_last: np.ndarray, T_found: np.ndarray, information: np.ndarray, depth: float) -> None:
        """Learn from an aligned frame.

        Args:
            T_last, T_found: (4, 4) poses of the last frame and of this one, in the same map.
            information: (6, 6) of the images on the pose, translations in usual depths.
            depth: usual depth.
        """
        innovation = log_twist(T_found @ np.linalg.inv(self.ahead(T_last, depth)[0])) / _units(depth)
        P = self._predicted()
        self.velocity = self.velocity + P[6:, :6] @ np.linalg.solve(P[:6, :6], innovation)
        self.covariance = self._updated(information)
        self._innovations.append(innovation)

    def _updated(self, information: np.ndarray) -> np.ndarray:
        """(12, 12) covariance after a frame of which images say so much."""
        P, A = self._predicted(), information
        # (P + A⁻¹)⁻¹ = A - A (A + P⁻¹)⁻¹ A, which an A without full rank has as well.
        seen = A - A @ np.linalg.solve(A + np.linalg.inv(P[:6, :6]), A)
        P = P - P[:, :6] @ seen @ P[:6]
        return 0.5 * (P + P.T)


def _units(depth: float) -> np.ndarray:
    return np.array([depth, depth, depth, 1.0, 1.0, 1.0])


def log_twist(T: np.ndarray) -> np.ndarray:
    """(6,) twist of a rigid motion, translation then rotation."""
    return np.roll(log_sim3(T[None])[0, :6], 3)
