"""A ring of keyframes whose drifted end sees the same points as its start."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from slam_scenes import CAMERA, VIEW

from dslab.slam.core.frame import Features, Frame, FrameFeatures
from dslab.slam.loop_closing.correction import Loop
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3_algebra import exp_sim3, invert_sim3

RADIUS_M, WALL_M = 4.0, 9.0


@dataclass
class Ring:
    """A drifted map, its truth and the loop that a perfect detector would find."""

    map: Map
    T_cam_world: np.ndarray
    xyz: np.ndarray
    ids: list[np.ndarray]
    loop: Loop
    loop_points: np.ndarray

    def centres(self) -> np.ndarray:
        """(K, 3) camera centres of the map."""
        T = self.map.arrays.kf_T_cam_map[: self.map.n_keyframes]
        return -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])

    def true_centres(self) -> np.ndarray:
        """(K, 3) camera centres of the world."""
        T = self.T_cam_world
        return -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])


def ring(keyframes=60, overlap=6):
    """A ring with a map of its own; the rest is shared and read only."""
    built = _ring(keyframes, overlap)
    return replace(built, map=built.map.copy())


@cache
def _ring(keyframes, overlap, points=3000, drift=(0.0, 0.0, 0.002, 0.01, 0.0, 0.004, 0.006), seed=0):
    """Keyframes once round a ring and ``overlap`` further, looking out; each step drifts by a twist."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, points)
    xyz = np.column_stack([WALL_M * np.cos(angle), WALL_M * np.sin(angle), rng.uniform(-2, 2, points)])
    descriptor = rng.integers(0, 2**64, (points, 4), dtype=np.uint64)
    total = keyframes + overlap
    T_cam_world = np.array([_outward(2 * np.pi * k / keyframes) for k in range(total)])
    built = Map(0, VIEW)
    # A keyframe's place in the drifted map: the truth, moved by all the drift so far.
    D = exp_sim3(np.outer(np.arange(total), drift))
    all_ids = []
    for k in range(total):
        frame, ids = _see(k, T_cam_world[k], xyz, descriptor, rng)
        S = T_cam_world[k] @ invert_sim3(D[k][None])[0]
        scale = np.cbrt(np.linalg.det(S[:3, :3]))
        frame.T_cam_map[:3, :3], frame.T_cam_map[:3, 3] = S[:3, :3] / scale, S[:3, 3] / scale
        built.add_keyframe(frame, k - 1)
        all_ids.append(ids)
    early = _points_of(built, range(keyframes // 2), all_ids, D, xyz)
    _points_of(built, range(keyframes // 2, total), all_ids, D, xyz)
    k, q = total - 2, total - 2 - keyframes
    again = np.flatnonzero(np.isin(all_ids[k], list(early)) & (all_ids[k] >= 0))
    S_k = T_cam_world[k] @ invert_sim3(D[q][None])[0]
    S_k = _in_units_of(S_k, D[k])
    loop = Loop(k, q, S_k, again, np.array([early[int(i)] for i in all_ids[k][again]], np.int32))
    return Ring(built, T_cam_world, xyz, all_ids, loop, np.array(sorted(early.values()), np.int32))


def _outward(angle):
    """T_cam_world of a camera on the ring that looks away from its centre, z up in the world."""
    forward = np.array([np.cos(angle), np.sin(angle), 0.0])
    right, down = np.array([np.sin(angle), -np.cos(angle), 0.0]), np.array([0.0, 0.0, -1.0])
    T = np.eye(4)
    T[:3, :3] = np.array([right, down, forward])
    T[:3, 3] = -T[:3, :3] @ (RADIUS_M * forward)
    return T


def _in_units_of(S, D):
    """The same similarity, its camera's lengths those of a place that has drifted by ``D``."""
    out = S.copy()
    out[:3] *= np.cbrt(np.linalg.det(D[:3, :3]))
    return out


def _see(index, T, xyz, descriptor, rng):
    p = xyz @ T[:3, :3].T + T[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        xy = p[:, :2] / p[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
    ids = np.flatnonzero((p[:, 2] > 1) & (xy > 4).all(1) & (xy < (635, 475)).all(1))
    features = Features(
        xy[ids].astype(np.float32),
        np.full(len(ids), 2, np.int32),
        np.zeros(len(ids), np.float32),
        np.ones(len(ids), np.float32),
        descriptor[ids],
    )
    frame = Frame(FrameFeatures.build(index, index / 30, features, CAMERA, VIEW))
    frame.T_cam_map = np.eye(4)
    where = {tuple(x): int(i) for x, i in zip(features.xy.tolist(), ids.tolist(), strict=True)}
    return frame, np.array([where[tuple(x)] for x in frame.features.xy_image.tolist()])


def _points_of(built, rows, all_ids, D, xyz):
    """Points seen twice by a run of keyframes, placed as the first of them has drifted; id to point."""
    seen: dict[int, list[int]] = {}
    for k in rows:
        for i, world in enumerate(all_ids[k]):
            seen.setdefault(int(world), []).append(built.keypoints(k).start + i)
    points = {}
    for world, keypoints in seen.items():
        if len(keypoints) < 3:
            continue
        k = int(built.arrays.kp_keyframe[keypoints[len(keypoints) // 2]])
        points[world] = built.create_point(D[k][:3, :3] @ xyz[world] + D[k][:3, 3], keypoints[0])
        for row in keypoints[1:]:
            kernels.add_observation(built.arrays, row, points[world])
        kernels.refresh_point(built.arrays, points[world], VIEW)
    return points
