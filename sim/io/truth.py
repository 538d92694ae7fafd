"""Ground-truth tables: poses by stamp, assigned to the frames nearest in time."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import is_given
from dslab.sim.io.text import check_order, check_words, data_rows, read_rows, to_numbers, to_stamp

# Farther positions are no metres; their squares would leave the alignment no digits.
MOST_POSITION_M = 1e9
"""Largest coordinate that is read, of a truth or of a path that the lab has written."""
_MOST_SKEW = 1e-2
# Motion capture misses some frames of every recording.
_LEAST_COVERED = 0.9
_TUM_NAMES = ["stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]


def read_tum_poses(
    path: Path, stamps_s: np.ndarray, tolerance_s: float, origin_s: float = 0.0
) -> np.ndarray | None:
    """Read the frames' poses from a file of ``stamp tx ty tz qx qy qz qw``.

    A pose with nan counts as none: TUM-mono marks frames outside motion capture so.

    Args:
        path: the file.
        stamps_s: (N,) stamps of the frames.
        tolerance_s: largest time between a frame and its pose.
        origin_s: time of the file's clock at 0 s of the frames', for a file that only begins after these.

    Returns:
        (N, 4, 4), NaN where no pose lies within the tolerance; None without the file.

    Raises:
        InputError: the file is malformed, holds no pose, or has another clock.
    """
    if not is_given(path):
        return None
    rows: list[list[float]] = []
    for where, words in data_rows(path, read_rows(path, "")):
        check_words(where, words, _TUM_NAMES)
        row = [to_stamp(where, words[0]), *_pose_numbers(where, words[1:])]
        check_order(where, [r[0] for r in rows[-1:]], row[0])
        if len(row) < len(_TUM_NAMES):
            continue
        check_pose(where, row[1:])
        rows.append(row)
    if not rows:
        raise InputError(str(path), "holds no pose", "add poses, or delete it to run without ground truth")
    table = np.array(rows)
    poses = poses_of(table[:, 1:4], table[:, 4:])
    table_s = table[:, 0] - (origin_s if table[0, 0] > stamps_s[-1] + tolerance_s else 0.0)
    return nearest_poses(path, stamps_s, table_s, poses, tolerance_s)


def _pose_numbers(where: str, words: list[str]) -> list[float]:
    """The numbers of a pose that are not nan. Raises InputError for any other word."""
    known = {name: word for name, word in zip(_TUM_NAMES[1:], words, strict=True) if word.lower() != "nan"}
    return to_numbers(where, list(known.values()), list(known))


def tum_poses_text(stamps_s: np.ndarray, T_world_cam: np.ndarray, written: list[str] | None = None) -> str:
    """Poses in TUM's order, with stamps as written if given; frames without a pose are left out."""
    written = [f"{stamp_s:.9f}" for stamp_s in stamps_s] if written is None else written
    known = np.isfinite(T_world_cam).all(axis=(1, 2))
    quat_xyzw = Rotation.from_matrix(T_world_cam[known, :3, :3]).as_quat(canonical=True)
    rows = np.column_stack([T_world_cam[known, :3, 3], quat_xyzw])
    lines = ["# stamp_s tx ty tz qx qy qz qw, camera (x right, y down, z forward) to world, metres"]
    lines += [
        " ".join([written[frame], *(f"{value:.9f}" for value in row)])
        for frame, row in zip(np.flatnonzero(known), rows, strict=True)
    ]
    return "\n".join(lines) + "\n"


def is_rotation(R: np.ndarray) -> bool:
    """Return True for a (3, 3) rotation matrix, printed with two digits or more."""
    if np.abs(R).max() > 1 + _MOST_SKEW:
        return False
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= _MOST_SKEW and np.linalg.det(R) > 0)


def check_rigid(where: str, T: np.ndarray) -> None:
    """Raise InputError unless (3, 4) or (4, 4) rows are a rotation and a translation in metres."""
    if not is_rotation(T[:3, :3]) or (len(T) > 3 and list(T[3]) != [0, 0, 0, 1]):
        raise InputError(where, "is no rotation and translation", "write the rows of [R t]")
    check_position(where, T[:3, 3])


def check_position(where: str, position_m: Iterable[float]) -> None:
    """Raise InputError for a position that cannot be one in metres."""
    for value in position_m:
        if abs(value) > MOST_POSITION_M:
            problem = f"{value:g} is no coordinate in metres"
            raise InputError(f"{where}: position", problem, f"give metres, at most {MOST_POSITION_M:g}")


def check_pose(where: str, pose: list[float], names: list[str] = _TUM_NAMES[1:]) -> None:
    """Raise InputError for seven numbers, in the order of the names, that are no position and quaternion."""
    check_position(where, pose[:3])
    check_quaternion(f"{where}: {' '.join(names[3:])}", pose[3:])


def check_quaternion(where: str, values: list[float]) -> None:
    """Raise InputError unless four numbers make a unit quaternion to a hundredth."""
    norm = math.hypot(*values)
    if not 0.99 < norm < 1.01:
        raise InputError(where, f"has length {norm:.4g}", "give a unit quaternion")


def poses_of(position_m: np.ndarray, quat_xyzw: np.ndarray) -> np.ndarray:
    """(M, 4, 4) from (M, 3) positions and (M, 4) quaternions."""
    T = np.tile(np.eye(4), (len(position_m), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
    T[:, :3, 3] = position_m
    return T


def half_interval_s(stamps_s: np.ndarray, fps: float) -> float:
    """Half the median frame interval; for a single frame, by the nominal rate."""
    return float(np.median(np.diff(stamps_s))) / 2 if len(stamps_s) > 1 else 0.5 / fps


def nearest_poses(
    path: Path, stamps_s: np.ndarray, table_s: np.ndarray, poses: np.ndarray, tolerance_s: float
) -> np.ndarray:
    """(N, 4, 4) pose nearest in time to each frame, without interpolation; NaN where none is near enough.

    Raises:
        InputError: of the file, if no frame has a pose within the tolerance.
    """
    best = nearest(table_s, stamps_s, tolerance_s)
    near = best >= 0
    if not near.any():
        raise other_clock(path, table_s, stamps_s, tolerance_s)
    T = np.full((len(stamps_s), 4, 4), np.nan)
    T[near] = poses[best[near]]
    return T


def other_clock(path: Path, table_s: np.ndarray, stamps_s: np.ndarray, tolerance_s: float) -> InputError:
    """The fault of a file of (M,) stamps of which none is near the (N,) of the frames."""
    ranges = [f"{times[0]:.10g} to {times[-1]:.10g} s" for times in (table_s, stamps_s)]
    problem = f"no stamp of {ranges[0]} lies within {tolerance_s:.4g} s of a frame's, {ranges[1]}"
    shift = f"{stamps_s[0] - table_s[0]:+.10g}"
    remedy = f"give both files the same clock ({shift} s here, if both began together), or leave this one out"
    return InputError(str(path), problem, remedy)


def told_coverage(where: str, stamps_s: np.ndarray, T_world_cam: np.ndarray | None) -> np.ndarray | None:
    """The (N, 4, 4) poses, said where many frames have none; None where fewer than two have one."""
    if T_world_cam is None or len(stamps_s) < 2:
        return T_world_cam
    known = np.flatnonzero(np.isfinite(T_world_cam).all(axis=(1, 2)))
    if len(known) < 2:
        count = "one frame" if len(known) else "no frame"
        notice(
            where, f"{count} has a true pose: nothing can be aligned, the sequence counts as without truth"
        )
        return None
    if len(known) < _LEAST_COVERED * len(stamps_s):
        times = f"from {stamps_s[known[0]]:.10g} to {stamps_s[known[-1]]:.10g} s"
        notice(
            where, f"truth covers {len(known)} of {len(stamps_s)} frames, {times}: ATE speaks of these alone"
        )
    return T_world_cam


def nearest(table_s: np.ndarray, stamps_s: np.ndarray, tolerance_s: float) -> np.ndarray:
    """(N,) index of the nearest of (M,) increasing times, -1 if none is near."""
    after = np.clip(np.searchsorted(table_s, stamps_s), 1, max(1, len(table_s) - 1))
    pairs = np.stack([after - 1, np.minimum(after, len(table_s) - 1)])
    distance_s = np.abs(table_s[pairs] - stamps_s)
    best = pairs[distance_s.argmin(axis=0), np.arange(len(stamps_s))]
    return np.where(distance_s.min(axis=0) <= tolerance_s, best, -1)
