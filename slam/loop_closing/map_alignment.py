"""Similarity between two maps, or two ends of one, from one keyframe of each.

Source: Horn, 1987; Mur-Artal, Montiel, Tardos, "ORB-SLAM", 2015, section VII-B.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.core.settings import DEPTHS, setting, settings
from dslab.slam.loop_closing._alignment_kernels import match_across
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.matching.brute_force import match_oriented
from dslab.slam.matching.window import FREE_BITS
from dslab.slam.optimization.sim3 import (
    Sim3Result,
    optimize_sim3,
    ransac_sim3,
    sim3_decompose,
    sim3_inverse,
    sim3_matrix,
)


@settings
class Sim3AlignmentConfig:
    """Acceptance thresholds of an alignment."""

    min_candidates: int = setting(25, "3D-3D matches by descriptor, below which there is no overlap")
    min_inliers: int = setting(20, "fewest inliers of the RANSAC similarity")
    min_share: float = setting(0.5, "least share of inliers; a corrupted map does not fit", le=1)
    min_matches: int = setting(40, "fewest inliers after guided extension and refinement")


@settings
class Agreement:
    """Largest differences between two alignments that confirm each other."""

    max_scale_change: float = setting(0.05, "largest relative difference of scale of two similarities")
    max_rotation_deg: float = setting(2.0, "largest angle between two similarities")
    max_shift: float = setting(0.05, "largest distance of the second one's matched points", unit=DEPTHS)


@dataclass(frozen=True)
class Alignment:
    """Similarity between two maps, estimated at one pair of keyframes.

    Attributes:
        S_old_new: (4, 4) similarity from the new map to the old one.
        scale: its scale.
        old_map_id: the old map.
        old_keyframe, new_keyframe: the pair.
        old_points, new_points: (n,) int32 matched points.
        believed: chance that it is right, once it was asked.
    """

    S_old_new: np.ndarray
    scale: float
    old_map_id: int
    old_keyframe: int
    new_keyframe: int
    old_points: np.ndarray
    new_points: np.ndarray
    believed: float | None = None

    @property
    def inliers(self) -> int:
        """Number of matched points."""
        return len(self.old_points)


def align(
    old: Map,
    new: Map,
    old_keyframe: int,
    new_keyframe: int,
    rng: np.random.Generator,
    config: Sim3AlignmentConfig,
) -> tuple[Alignment | None, str, int]:
    """Estimate the similarity between two maps from one keyframe of each.

    ORB descriptors give 3D-3D matches between the two keyframes; RANSAC on Horn's closed form estimates the
    similarity, guided matching adds matches, and a final refinement minimises the reprojection errors in
    both keyframes.

    Returns:
        The alignment or None, the reason of a failure (``overlap`` or ``sim3``), final number of matches.
    """
    a, b = old.arrays, new.arrays
    old_rows, new_rows = matched_keypoints(old, new, old_keyframe, new_keyframe)
    if len(old_rows) < config.min_candidates:
        return None, "overlap", len(old_rows)
    solution = ransac_sim3(
        *_in_cameras(old, new, old_keyframe, new_keyframe, old_rows, new_rows),
        *_intrinsics(old),
        rng,
        min_inliers=config.min_inliers,
    )
    if not _holds(solution, len(old_rows), config):
        return None, "sim3", int(solution.inliers.sum()) if solution.success else 0
    keep = solution.inliers
    guess = (solution.s, solution.R, solution.t)
    old_rows, new_rows = _extended(
        old, new, old_keyframe, new_keyframe, old_rows[keep], new_rows[keep], sim3_matrix(*guess)
    )
    refined = optimize_sim3(
        *guess,
        *_in_cameras(old, new, old_keyframe, new_keyframe, old_rows, new_rows),
        *_intrinsics(old),
    )
    keep = refined.inliers
    if int(keep.sum()) < config.min_matches:
        return None, "sim3", int(keep.sum())
    S = sim3_matrix(refined.s, refined.R, refined.t)
    S_old_new = np.linalg.inv(old.T_cam_map(old_keyframe)) @ S @ new.T_cam_map(new_keyframe)
    return (
        Alignment(
            S_old_new,
            float(refined.s),
            old.map_id,
            old_keyframe,
            new_keyframe,
            a.kp_point[old_rows[keep]].copy(),
            b.kp_point[new_rows[keep]].copy(),
        ),
        "",
        int(keep.sum()),
    )


def align_relocalized(
    old: Map,
    new: Map,
    frame: Frame,
    new_keyframe: int,
    rng: np.random.Generator,
    config: Sim3AlignmentConfig,
) -> Alignment | None:
    """Estimate the similarity between two maps from a keyframe of one that is relocalized in the other.

    A view may find more points of the old map than any one of its keyframes shares with the new one.
    Keypoints with a point in both maps give the 3D-3D matches; then as in :func:`align`.

    Args:
        old, new: the maps.
        frame: the features of the keyframe, relocalized in the old map.
        new_keyframe: row of the keyframe.
        rng: stream of the RANSAC.
        config: thresholds.
    """
    new_points = new.observed_points(new_keyframe)
    seen = (frame.point >= 0) & (new_points >= 0)
    old_points, new_points = frame.point[seen], new_points[seen]
    if len(old_points) < config.min_candidates:
        return None
    T_cam_old, T_cam_new = frame.T_cam_map, new.T_cam_map(new_keyframe)
    pixels = frame.features.xy[seen]
    variances = 1.0 / new.view.inv_sigma2[frame.features.octave[seen]]
    both = (
        _moved(T_cam_old, old.arrays.pt_xyz[old_points]),
        _moved(T_cam_new, new.arrays.pt_xyz[new_points]),
        pixels, pixels, variances, variances,
    )  # fmt: skip
    found = ransac_sim3(*both, *_intrinsics(old), rng, min_inliers=config.min_inliers)
    if not _holds(found, len(old_points), config):
        return None
    found = optimize_sim3(found.s, found.R, found.t, *both, *_intrinsics(old))
    keep = found.inliers
    if int(keep.sum()) < config.min_matches:
        return None
    S_old_new = np.linalg.inv(T_cam_old) @ sim3_matrix(found.s, found.R, found.t) @ T_cam_new
    pair = frame.reference_keyframe, new_keyframe
    return Alignment(S_old_new, float(found.s), old.map_id, *pair, old_points[keep], new_points[keep])


def agree(old: Map, first: Alignment, second: Alignment, config: Agreement) -> bool:
    """Return True if two alignments of the same maps give the same similarity."""
    s_1, R_1, _ = sim3_decompose(first.S_old_new)
    s_2, R_2, _ = sim3_decompose(second.S_old_new)
    if abs(np.log(s_1 / s_2)) > np.log1p(config.max_scale_change):
        return False
    cosine = np.clip((np.trace(R_1.T @ R_2) - 1) / 2, -1, 1)
    if np.rad2deg(np.arccos(cosine)) > config.max_rotation_deg:
        return False
    depth = kernels.median_depth(old.arrays, second.old_keyframe)
    where = np.append(old.arrays.pt_xyz[second.old_points].mean(0), 1.0)
    moved = (first.S_old_new @ sim3_inverse(second.S_old_new) @ where)[:3]
    return bool(np.linalg.norm(moved - where[:3]) <= config.max_shift * depth)


def matched_keypoints(
    old: Map, new: Map, old_keyframe: int, new_keyframe: int
) -> tuple[np.ndarray, np.ndarray]:
    """Keypoint rows with points, in both maps, that match by descriptor."""
    a, b = old.arrays, new.arrays
    rows_a = old.keypoints(old_keyframe).start + np.flatnonzero(old.observed_points(old_keyframe) >= 0)
    rows_b = new.keypoints(new_keyframe).start + np.flatnonzero(new.observed_points(new_keyframe) >= 0)
    if not len(rows_a) or not len(rows_b):
        return rows_a[:0], rows_b[:0]
    pairs = match_oriented(
        a.kp_descriptor[rows_a],
        a.kp_angle[rows_a],
        b.kp_descriptor[rows_b],
        b.kp_angle[rows_b],
        FREE_BITS,
        0.75,
    )
    return rows_a[pairs[:, 0]], rows_b[pairs[:, 1]]


def _in_cameras(
    old: Map, new: Map, old_keyframe: int, new_keyframe: int, old_rows: np.ndarray, new_rows: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Points in their keyframe's camera frame, pixels and variances of matched keypoints, old before new."""
    sides = []
    for m, k, rows in ((old, old_keyframe, old_rows), (new, new_keyframe, new_rows)):
        xyz = _moved(m.T_cam_map(k), m.arrays.pt_xyz[m.arrays.kp_point[rows]])
        sides.append((xyz, m.arrays.kp_xy[rows], 1.0 / m.view.inv_sigma2[m.arrays.kp_octave[rows]]))
    (xyz_1, px_1, var_1), (xyz_2, px_2, var_2) = sides
    return xyz_1, xyz_2, px_1, px_2, var_1, var_2


def _moved(T: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    return xyz @ T[:3, :3].T + T[:3, 3]


def _holds(solution: Sim3Result, matches: int, config: Sim3AlignmentConfig) -> bool:
    inliers = int(solution.inliers.sum())
    return solution.success and inliers >= max(config.min_inliers, config.min_share * matches)


def _intrinsics(m: Map) -> tuple[float, float, float, float]:
    return m.view.fx, m.view.fy, m.view.cx, m.view.cy


def _extended(
    old: Map,
    new: Map,
    old_keyframe: int,
    new_keyframe: int,
    old_rows: np.ndarray,
    new_rows: np.ndarray,
    S_oldcam_newcam: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Add guided matches of the new keyframe's points in the old keyframe."""
    first_old, first_new = old.keypoints(old_keyframe).start, new.keypoints(new_keyframe).start
    free_new = new.observed_points(new_keyframe) >= 0
    free_new[new_rows - first_new] = False
    candidates_rows = np.flatnonzero(free_new)
    candidates = new.observed_points(new_keyframe)[candidates_rows]
    taken = old.observed_points(old_keyframe) < 0
    taken[old_rows - first_old] = True
    S = S_oldcam_newcam @ new.T_cam_map(new_keyframe)
    scale, _, _ = sim3_decompose(S)
    matched = match_across(new.arrays, candidates, S, scale, old.arrays, old.view, old_keyframe, taken, 7.5)
    hit = matched >= 0
    return (
        np.concatenate([old_rows, matched[hit] + first_old]),
        np.concatenate([new_rows, candidates_rows[hit] + first_new]),
    )
