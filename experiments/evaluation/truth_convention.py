"""Whether true orientations are the camera's, as they are read: compared with how the estimate turns.

How a camera turns between two frames depends on no frame of the world and on no scale. A file whose
quaternions have another order, whose poses are inverted, or which holds poses of a body or of cameras that
look along -z leaves the ATE nearly as it is, and makes orientations wrong by as much as the camera turns.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from dslab.experiments.evaluation.metrics import PosePairs, Truth
from dslab.slam.core.results import MapTrajectory

STEP_S = 1.0
"""Time between the poses that are compared, which follow each other: steps do not overlap."""
_SURE = 1e-4  # chance of a verdict where two conventions fit alike
_ONE_AXIS = 0.05  # share of the turns about other axes below which the axes' own turn is not determined
_HALF = 0.5  # a convention that fits has less than this share of the error of the poses as they are


def _reordered(shift: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda R: Rotation.from_quat(np.roll(Rotation.from_matrix(R).as_quat(), shift, axis=1)).as_matrix()


_READINGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "if its quaternions are in the order w x y z": _reordered(-1),
    "if its quaternions are in the order x y z w": _reordered(1),
    "if its poses take the world to the camera": lambda R: R.transpose(0, 2, 1),
    "if its cameras look along -z with y up, as in OpenGL": lambda R: R @ np.diag([1.0, -1.0, -1.0]),
}


def truth_fault(truth: Truth, path: MapTrajectory) -> str:
    """What speaks against the true orientations as they are read, in words; empty for nothing.

    Each reading is compared second by second with the truth as it is; a sign test over the seconds decides.

    Args:
        truth: of the sequence.
        path: estimated poses of one map.
    """
    pairs = truth.pairs(path)
    starts, ends = _steps(pairs, truth.stamps_s)
    if not len(starts):
        return ""
    turned = _turns(pairs.T_map_cam[:, :3, :3], starts, ends)
    R = pairs.T_world_cam[:, :3, :3]
    as_read = _errors_deg(turned, _turns(R, starts, ends))
    readings = {name: _errors_deg(turned, _turns(read(R), starts, ends)) for name, read in _READINGS.items()}
    if (body := _of_a_body(turned, R, starts, ends)) is not None:
        readings["if it is of a body that carries the camera"] = _errors_deg(turned, body)
    fit = {name: errors for name, errors in readings.items() if _fits_better(errors, as_read)}
    if not fit:
        return ""
    best = min(float(np.median(errors)) for errors in fit.values())
    # Any that fits about as well: the body's, which has three parameters of its own, comes last.
    name = next(name for name, errors in fit.items() if np.median(errors) <= 2 * best)
    found, given = np.median(fit[name]), np.median(as_read)
    return f"the true orientations fit ({found:.2g} instead of {given:.2g} degrees a second) {name}"


def _steps(pairs: PosePairs, stamps_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m,) rows of the first and last poses of steps of a second that follow each other."""
    times_s = stamps_s[pairs.frames]
    if not len(times_s):
        return np.empty(0, int), np.empty(0, int)
    steps = np.unique((times_s - times_s[0]) // STEP_S)
    # Of a gap, which may be of years, its ends alone.
    begins_s = times_s[0] + STEP_S * np.union1d(steps, steps + 1)
    marks = np.searchsorted(times_s, begins_s[begins_s < times_s[-1]])
    starts, ends = marks[:-1], marks[1:]
    whole = np.abs(times_s[ends] - times_s[starts] - STEP_S) < STEP_S / 2
    return starts[whole], ends[whole]


def _of_a_body(turned: Rotation, R: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> Rotation | None:
    """The turns about axes that are turned as fits best; None if all are about one axis."""
    own, truly = turned.as_rotvec(), _turns(R, starts, ends).as_rotvec()
    spread = np.linalg.svd(own, compute_uv=False)
    if len(own) < 3 or spread[1] < _ONE_AXIS * spread[0] or not truly.any():
        return None
    fixed = Rotation.align_vectors(own, truly)[0]
    return _turns(R @ fixed.inv().as_matrix(), starts, ends)


def _turns(R: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> Rotation:
    return Rotation.from_matrix(R[starts]).inv() * Rotation.from_matrix(R[ends])


def _errors_deg(turned: Rotation, truly: Rotation) -> np.ndarray:
    return np.degrees((turned.inv() * truly).magnitude())


def _fits_better(errors: np.ndarray, as_read: np.ndarray) -> bool:
    better = int((errors < as_read).sum())
    sure = binomtest(better, len(errors), alternative="greater").pvalue < _SURE
    return bool(sure and np.median(errors) < _HALF * np.median(as_read))
