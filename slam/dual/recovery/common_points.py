"""One similarity from all the points that two maps have in common, at the end of a recovery.

Source: paper, Sec. III-C, Eq. 2; the closed form: Horn, 1987.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.loop_closing.map_alignment import Alignment, Sim3AlignmentConfig, matched_keypoints
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import horn_sim3, sim3_inverse, sim3_matrix

_ITERATIONS = 300
_REFITS = 3
_CHI2 = 9.21
_NEAREST = 1e-6  # smallest depth, map units


@dataclass(frozen=True)
class _Side:
    """The points of one map, a row per match, and the keyframes that see them.

    Attributes:
        rows: (n,) points.
        xyz: (n, 3) their positions.
        keyframe: (n,) keyframe of each match.
        T_cam_map: (n, 4, 4) its pose.
        px: (n, 2) the keypoint in it.
        sigma2: (n,) its variance, px².
    """

    rows: np.ndarray
    xyz: np.ndarray
    keyframe: np.ndarray
    T_cam_map: np.ndarray
    px: np.ndarray
    sigma2: np.ndarray

    @classmethod
    def of(cls, m: Map, keyframe: np.ndarray, keypoints: np.ndarray) -> "_Side":
        a = m.arrays
        rows = a.kp_point[keypoints]
        sigma2 = 1.0 / m.view.inv_sigma2[a.kp_octave[keypoints]]
        T = np.array([m.T_cam_map(int(k)) for k in keyframe]).reshape(-1, 4, 4)
        return cls(rows, a.pt_xyz[rows].copy(), keyframe, T, a.kp_xy[keypoints], sigma2)

    def sees(self, m: Map, xyz: np.ndarray) -> np.ndarray:
        """(n,) bool: the keypoints are where positions (n, 3) in this map would be seen."""
        in_cam = np.einsum("nij,nj->ni", self.T_cam_map[:, :3, :3], xyz) + self.T_cam_map[:, :3, 3]
        z = np.maximum(in_cam[:, 2], _NEAREST)
        view = m.view
        seen = in_cam[:, :2] / z[:, None] * (view.fx, view.fy) + (view.cx, view.cy)
        off = ((seen - self.px) ** 2).sum(axis=1)
        return (in_cam[:, 2] > _NEAREST) & (off <= _CHI2 * self.sigma2)


def align_all(
    old: Map, new: Map, pairs: list[tuple[int, int]], rng: np.random.Generator, config: Sim3AlignmentConfig
) -> tuple[Alignment | None, str, int]:
    """Estimate the similarity between two maps from the points of many pairs of keyframes together.

    ORB descriptors give 3D-3D matches; RANSAC on Horn's closed form estimates the similarity, by the
    reprojection errors in both keyframes of each match.

    Args:
        old, new: the maps.
        pairs: (keyframe of the old map, keyframe of the new one) that are compared.
        rng: stream of the RANSAC.
        config: ``min_candidates``, ``min_inliers`` and ``min_share`` hold for all matches together.

    Returns:
        The alignment, at the pair with most inliers, or None; the reason of a failure (``overlap`` or
        ``sim3``); the final number of matches.
    """
    sides = _matches(old, new, pairs)
    if sides is None or len(sides[0].rows) < config.min_candidates:
        return None, "overlap", 0 if sides is None else len(sides[0].rows)
    theirs, ours = sides
    S, inlier = _ransac(old, new, theirs, ours, rng)
    count = int(inlier.sum())
    if count < config.min_inliers or count < config.min_share * len(inlier):
        return None, "sim3", count
    kept = _one_to_one(theirs.rows, ours.rows, np.flatnonzero(inlier))
    most = np.unique(np.stack([theirs.keyframe, ours.keyframe])[:, kept], axis=1, return_counts=True)
    old_keyframe, new_keyframe = most[0][:, most[1].argmax()]
    found = Alignment(
        S,
        float(np.cbrt(np.linalg.det(S[:3, :3]))),
        old.map_id,
        int(old_keyframe),
        int(new_keyframe),
        theirs.rows[kept].astype(np.int32),
        ours.rows[kept].astype(np.int32),
    )
    return found, "", len(kept)


def pairs_close_in_time(
    old: Map, new: Map, keyframes: list[int], config: FusionConfig
) -> list[tuple[int, int]]:
    """Pairs (old, new) of the old map's keyframes and those given of the new one, close in time."""
    olds = [int(k) for k in old.keyframes()]
    stamps_s = np.array([old.features(k).stamp_s for k in olds])
    pairs = []
    for new_keyframe in keyframes:
        if not new.arrays.kf_bad[new_keyframe]:
            apart_s = np.abs(stamps_s - new.features(new_keyframe).stamp_s).round(6)
            pairs += [(olds[i], new_keyframe) for i in np.flatnonzero(apart_s <= config.max_time_gap_s)]
    return pairs


def _matches(old: Map, new: Map, pairs: list[tuple[int, int]]) -> tuple[_Side, _Side] | None:
    """Both sides of all matches, each pair of points once; None without any."""
    found = [
        (np.full(len(theirs), k), np.full(len(ours), j), theirs, ours)
        for k, j in pairs
        for theirs, ours in [matched_keypoints(old, new, k, j)]
    ]
    if not sum(len(rows[0]) for rows in found):
        return None
    k, j, theirs, ours = map(np.concatenate, zip(*found, strict=True))
    points = np.stack([old.arrays.kp_point[theirs], new.arrays.kp_point[ours]])
    first = np.sort(np.unique(points, axis=1, return_index=True)[1])
    return _Side.of(old, k[first], theirs[first]), _Side.of(new, j[first], ours[first])


def _ransac(
    old: Map, new: Map, theirs: _Side, ours: _Side, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(4, 4) S_old_new with most inliers, fitted to them; (n,) bool the inliers."""

    def inliers_of(S: np.ndarray) -> np.ndarray:
        S_new_old = sim3_inverse(S)
        to_old = ours.xyz @ S[:3, :3].T + S[:3, 3]
        to_new = theirs.xyz @ S_new_old[:3, :3].T + S_new_old[:3, 3]
        return theirs.sees(old, to_old) & ours.sees(new, to_new)

    def fitted(rows: np.ndarray) -> np.ndarray | None:
        try:
            s, R, t = horn_sim3(theirs.xyz[rows], ours.xyz[rows])
        except ValueError:
            return None
        return sim3_matrix(s, R, t) if s > 0 else None

    n = len(theirs.rows)
    best, most = np.eye(4), np.zeros(n, bool)
    for _ in range(_ITERATIONS):
        S = fitted(rng.choice(n, 3, replace=False))
        if S is not None and (inlier := inliers_of(S)).sum() > most.sum():
            best, most = S, inlier
    for _ in range(_REFITS):
        S = fitted(np.flatnonzero(most)) if most.sum() >= 3 else None
        if S is None or (inlier := inliers_of(S)).sum() < most.sum():
            break
        best, most = S, inlier
    return best, most


def _one_to_one(theirs: np.ndarray, ours: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The ``rows`` reduced so that no point of either map occurs twice; the first one stays."""
    rows = rows[np.sort(np.unique(theirs[rows], return_index=True)[1])]
    return rows[np.sort(np.unique(ours[rows], return_index=True)[1])]
