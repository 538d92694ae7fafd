"""View overlap on either side of a stress, from exact depth: can images alone bring the two together?"""

from collections.abc import Callable, Iterable
from functools import cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dslab.scenarios.spec import Scenario
from dslab.sim.depth_thumbnails import depth_renderer, thumbnail_camera
from dslab.sim.frame_plan import RenderBackend
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.shared_view import seen_share

RESCUABLE_OVERLAP = 0.2
"""Least overlap of views that recovery by images can be asked to bridge."""
_SAME_DEPTH = 0.05
# Frames of each side in the coarse search, and pairs of them about which it is refined.
_COARSE, _REFINED = 24, 4


class BestOverlap(NamedTuple):
    """Largest view overlap of two frames.

    Attributes:
        overlap: in [0, 1].
        frames: the frame before the stress and the one after it; None if one side has no frame.
    """

    overlap: float
    frames: tuple[int, int] | None

    @property
    def is_rescuable(self) -> bool:
        """See the function ``is_rescuable``."""
        return is_rescuable(self.overlap)


def is_rescuable(overlap: float) -> bool:
    """False if the largest overlap about a stress makes it geometrically hopeless."""
    return overlap >= RESCUABLE_OVERLAP


def view_overlap(
    depth_a: np.ndarray,
    T_world_cam_a: np.ndarray,
    depth_b: np.ndarray,
    T_world_cam_b: np.ndarray,
    intrinsics: Intrinsics,
) -> float:
    """Share of the surface in one view that is seen in the other too; the smaller of both directions.

    A pixel's surface is seen if it lies in the other image, the depth there agrees within 5 %, and the other
    camera is on the same side of it: the two faces of a thin wall have nothing in common. Pixels without a
    surface, such as the sky, do not count.

    Args:
        depth_a, depth_b: (H, W) float32 metres along the optical axis, 0 for no surface.
        T_world_cam_a, T_world_cam_b: (4, 4) float64 camera to world.
        intrinsics: of both images, without distortion.

    Returns:
        In [0, 1]; 0 if a view has no surface.

    Raises:
        ValueError: an image is not of the camera's size, or the camera has distortion.
    """
    size = (intrinsics.height_px, intrinsics.width_px)
    if not (depth_a.shape == depth_b.shape == size and intrinsics.is_pinhole):
        raise ValueError(f"{depth_a.shape} and {depth_b.shape} are not images of a pinhole camera of {size}")
    depth_a, depth_b = (np.ascontiguousarray(depth, np.float32) for depth in (depth_a, depth_b))
    focal_px = np.array([intrinsics.fx, intrinsics.fy], float)
    centre_px = np.array([intrinsics.cx, intrinsics.cy], float)
    R_b_a = np.ascontiguousarray(T_world_cam_b[:3, :3].T @ T_world_cam_a[:3, :3])
    R_a_b = np.ascontiguousarray(R_b_a.T)
    t_b_a = T_world_cam_b[:3, :3].T @ (T_world_cam_a[:3, 3] - T_world_cam_b[:3, 3])
    there = seen_share(depth_a, depth_b, R_b_a, t_b_a, focal_px, centre_px, _SAME_DEPTH)
    back = seen_share(depth_b, depth_a, R_a_b, -R_a_b @ t_b_a, focal_px, centre_px, _SAME_DEPTH)
    return min(there, back)


def best_overlap(
    scenario: Scenario,
    T_world_cam: np.ndarray,
    usable_before: Iterable[int],
    usable_after: Iterable[int],
    *,
    cache_dir: Path | None = None,
    backend: RenderBackend | None = None,
) -> BestOverlap:
    """Find the largest view overlap of a usable frame before a stress and one after it.

    At most 24 frames of each side, evenly spread, are compared each with each; about the best four pairs the
    search goes on with ever smaller steps, down to single frames. With at most 24 frames on each side it is
    exhaustive. It is deterministic, and never finds more than there is.

    Args:
        scenario: whose world and camera count; what its segments do to the images does not.
        T_world_cam: (N, 4, 4) float64 true poses of the sequence's frames, NaN where unknown.
        usable_before, usable_after: indices of the frames that a recovery could use: in the buffer before the
            stress, and behind it. Frames without a pose are left out.
        cache_dir: folder of the cache; None for the default one.
        backend: worlds and renderer; None for MuJoCo.

    Raises:
        InputError: as ``sim.depth_thumbnails.depth_thumbnails``.
    """
    before, after = (_with_pose(frames, T_world_cam) for frames in (usable_before, usable_after))
    if not (before and after):
        return BestOverlap(0.0, None)
    camera = thumbnail_camera(scenario.camera)
    with depth_renderer(scenario, camera, cache_dir=cache_dir, backend=backend) as depth_of:
        depth = cache(lambda frame: depth_of(T_world_cam[frame]))

        def overlap(pair: tuple[int, int]) -> float:
            a, b = before[pair[0]], after[pair[1]]
            return view_overlap(depth(a), T_world_cam[a], depth(b), T_world_cam[b], camera)

        (i, j), most = _largest(overlap, len(before), len(after))
    return BestOverlap(most, (before[i], after[j]))


def _largest(
    overlap: Callable[[tuple[int, int]], float], rows: int, columns: int
) -> tuple[tuple[int, int], float]:
    """The best of rows times columns pairs, of equal ones the earliest, and its overlap."""
    known: dict[tuple[int, int], float] = {}

    def at(pair: tuple[int, int]) -> float:
        if pair not in known:
            known[pair] = overlap(pair)
        return known[pair]

    def ranked() -> list[tuple[int, int]]:
        return sorted(known, key=lambda pair: (-known[pair], pair))

    def climb(pair: tuple[int, int], row_step: int, column_step: int) -> None:
        """Look about a pair, go on from the best one, and halve the steps where there is none better."""
        while row_step > 1 or column_step > 1:
            row_step, column_step = (row_step + 1) // 2, (column_step + 1) // 2
            centre = None
            while centre != pair:
                centre = pair
                around = product(_about(pair[0], row_step, rows), _about(pair[1], column_step, columns))
                pair = max(around, key=lambda near, centre=centre: (at(near), near == centre))

    (coarse_rows, row_step), (coarse_columns, column_step) = _spread(rows), _spread(columns)
    for pair in product(coarse_rows, coarse_columns):
        at(pair)
    for pair in ranked()[:_REFINED]:
        climb(pair, row_step, column_step)
    best = ranked()[0]
    return best, known[best]


def _with_pose(frames: Iterable[int], T_world_cam: np.ndarray) -> list[int]:
    return [int(frame) for frame in frames if np.isfinite(T_world_cam[int(frame)]).all()]


def _spread(count: int) -> tuple[list[int], int]:
    """Places of the coarse search among ``count``, both ends included, and the largest step between them."""
    places = np.unique(np.rint(np.linspace(0, count - 1, min(count, _COARSE))).astype(int)).tolist()
    return places, int(np.diff(places, prepend=places[0]).max())


def _about(place: int, step: int, count: int) -> list[int]:
    """A place and those a step to either side that exist."""
    return [near for near in (place - step, place, place + step) if 0 <= near < count]
