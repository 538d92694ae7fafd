"""Similarity and rigid alignment of an estimated path to the true one; poses must not be NaN."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Undefined:
    """Placeholder for a figure that the data do not determine, with the reason."""

    reason: str


@dataclass(frozen=True)
class Similarity:
    """``S_world_map``: ``p_world = scale * R_world_map @ p_map + t_world_map``.

    Attributes:
        scale: metres per unit of the map.
        R_world_map: (3, 3) float64 rotation.
        t_world_map: (3,) float64, metres.
    """

    scale: float
    R_world_map: np.ndarray
    t_world_map: np.ndarray

    def points(self, p_map: np.ndarray) -> np.ndarray:
        """(n, 3) points of the map in the world, metres."""
        return self.scale * p_map @ self.R_world_map.T + self.t_world_map

    def poses(self, T_map_cam: np.ndarray) -> np.ndarray:
        """(n, 4, 4) camera poses in the map as rigid camera poses in the world."""
        T_world_cam = np.array(T_map_cam, float)
        T_world_cam[:, :3, :3] = self.R_world_map @ T_map_cam[:, :3, :3]
        T_world_cam[:, :3, 3] = self.points(T_map_cam[:, :3, 3])
        return T_world_cam


IDENTITY = Similarity(1.0, np.eye(3), np.zeros(3))


def umeyama(p_map: np.ndarray, p_world: np.ndarray) -> Similarity | Undefined:
    """Least-squares Sim(3) alignment of positions, by which ATE is defined.

    Args:
        p_map: (n, 3) float64 estimated positions.
        p_world: (n, 3) float64 true positions, metres.

    Returns:
        The alignment; Undefined for fewer than 3 positions and if one of the paths does not move. A path on a
        line leaves the rotation about it open, on which no position error depends: any is given.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    PAMI 1991, eqs. 34-43.
    """
    n = len(p_map)
    if n < 3:
        return Undefined(f"{n} poses, alignment needs 3")
    mean_map, mean_world = p_map.mean(axis=0), p_world.mean(axis=0)
    centred_map, centred_world = p_map - mean_map, p_world - mean_world
    for name, p, centred in (("estimated", p_map, centred_map), ("true", p_world, centred_world)):
        if _stands_still(p, centred):
            return Undefined(f"the {name} path does not move")
    u, d, vt = np.linalg.svd(centred_world.T @ centred_map / n)
    sign = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        sign[2] = -1
    R = (u * sign) @ vt
    scale = float((d * sign).sum() / (centred_map**2).sum(axis=1).mean())
    return Similarity(scale, R, mean_world - scale * R @ mean_map)


def align_poses(T_map_cam: np.ndarray, T_world_cam: np.ndarray) -> Similarity | Undefined:
    """Sim(3) alignment with rotation from orientations, scale and translation from positions.

    The positions of a camera that moves straight leave the rotation about its line of travel free, its
    orientations do not; frames after such a stretch can be judged only with this alignment.

    Args:
        T_map_cam: (n, 4, 4) float64 estimated poses.
        T_world_cam: (n, 4, 4) float64 true poses of the same camera frame, metres.

    Returns:
        The alignment; Undefined for fewer than 3 poses or if one of the paths does not move.
    """
    n = len(T_map_cam)
    if n < 3:
        return Undefined(f"{n} poses, alignment needs 3")
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", T_world_cam[:, :3, :3], T_map_cam[:, :3, :3]))
    R = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    p_map, p_world = T_map_cam[:, :3, 3], T_world_cam[:, :3, 3]
    turned = (p_map - p_map.mean(axis=0)) @ R.T
    centred = p_world - p_world.mean(axis=0)
    if _stands_still(p_map, turned):
        return Undefined("the estimated path does not move")
    scale = float((centred * turned).sum() / (turned**2).sum())
    if scale <= 0 or not np.isfinite(scale):
        return Undefined("the estimated path does not follow the true one at any scale")
    return Similarity(scale, R, p_world.mean(axis=0) - scale * R @ p_map.mean(axis=0))


def rotation_angle_deg(R: np.ndarray) -> np.ndarray:
    """Angle of rotation, degrees, of (n, 3, 3) rotation matrices; accurate near 0 and 180."""
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine, cosine = np.linalg.norm(axis, axis=1), np.trace(R, axis1=1, axis2=2) - 1
    return np.degrees(np.arctan2(sine, cosine))


def _stands_still(p: np.ndarray, centred: np.ndarray) -> bool:
    """True for (n, 3) positions, less their mean, that do not move beyond rounding: they have no scale."""
    return float((centred**2).sum()) <= len(p) * np.finfo(float).eps * float((p**2).sum() + 1e-12)
