"""Small worlds of every kind, poses along their routes, and errors of optical flow against the truth."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import pytest

from dslab.scenarios.worlds import (
    BuildingWorld,
    CityWorld,
    CorridorWorld,
    FieldWorld,
    MotorwayWorld,
    RoomWorld,
    WarehouseWorld,
)
from dslab.sim.depth_thumbnails import depth_renderer, thumbnail_camera
from dslab.sim.rendering.renderer import Renderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds import build_world
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.geometry.route import arc_length

CAMERA = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0)
SMALL = {
    "room": RoomWorld(length_m=8, width_m=6, height_m=3),
    "corridor": CorridorWorld(length_m=22, turns=1),
    "building": BuildingWorld(floors=2, length_m=18),
    "city": CityWorld(length_m=160, turns=1),
    "motorway": MotorwayWorld(length_m=200),
    "field": FieldWorld(size_m=40),
    "warehouse": WarehouseWorld(length_m=14, aisles=2, height_m=5),
}


@contextmanager
def cheap_textures() -> Iterator[None]:
    """Build worlds with their true geometry and tiny textures, which still differ by seed and surface."""

    def tiny(finish, size_m, scale, rng) -> np.ndarray:
        return rng.integers(80, 140, (8, 8), dtype=np.uint8)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dslab.sim.worlds.assembly.paint", tiny)
        patch.setattr("dslab.sim.worlds.assembly.draw", tiny)
        patch.setattr("dslab.sim.worlds.indoor.light.Light.gain", lambda *_: np.ones((2, 2), np.float32))
        yield


@cache
def cheap_world(kind: str, seed: int) -> WorldModel:
    """The small world of a kind with ``cheap_textures``."""
    with cheap_textures():
        return build_world(SMALL[kind], seed)


def depth_thumbnails(scenario, T_world_cam, **more) -> tuple[np.ndarray, Intrinsics]:
    """Small depth images (N, h, w) at poses, and their camera."""
    camera = thumbnail_camera(scenario.camera)
    with depth_renderer(scenario, camera, **more) as depth_of:
        return np.array([depth_of(pose) for pose in T_world_cam]), camera


def length(route: Route) -> float:
    """Metres in plan."""
    return float(arc_length(route.centre_m)[-1])


def on_ground(route: Route, s_m: float | np.ndarray) -> np.ndarray:
    """(..., 3) points of the ground at lengths along a route in plan."""
    arc = arc_length(route.centre_m)
    ground_m = np.zeros(len(arc)) if route.height_m is None else route.height_m
    line = np.column_stack([route.centre_m, ground_m])
    return np.stack([np.interp(s_m, arc, column) for column in line.T], axis=-1)


def every(route: Route, step_m: float) -> np.ndarray:
    """(K, 3) points of the ground along a route, a step apart."""
    return on_ground(route, np.arange(0, length(route), step_m))


def distance_to_route(points: np.ndarray, route: Route) -> np.ndarray:
    """(N,) distances in plan of (N, 2) points."""
    corners = np.vstack([route.centre_m, route.centre_m[:1]]) if route.closed else route.centre_m
    distances = []
    for a, b in pairwise(corners):
        # A closed line may already end where it starts.
        share = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0, 1)
        distances.append(np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return np.min(distances, axis=0)


def along(route: Route, s_m: float, gaze_deg: float = 0.0, height_m: float = 1.5) -> np.ndarray:
    """(4, 4) pose of a level camera at an arc length of the route, looking ahead or aside to the left."""
    here, ahead = on_ground(route, np.array([s_m, s_m + 0.05]))
    heading = np.arctan2(*(ahead - here)[1::-1]) + np.deg2rad(gaze_deg)
    forward, down = np.array([np.cos(heading), np.sin(heading), 0]), np.array([0.0, 0, -1])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.cross(down, forward), down, forward])
    T[:3, 3] = here + np.array([0, 0, height_m])
    return T


def moved(T_world_cam: np.ndarray, ahead_m: float, turn_deg: float) -> np.ndarray:
    """(4, 4) the pose after a small step ahead and a small turn to the left."""
    T = T_world_cam.copy()
    T[:3, 3] += ahead_m * T[:3, 2]
    cos, sin = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    T[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ T[:3, :3]
    return T


def poses(route: Route, count: int) -> list[np.ndarray]:
    """(4, 4) each, of level cameras from the start of a route to its end."""
    return [along(route, s) for s in np.linspace(0.2, length(route) - 0.3, count)]


def reproject(
    points_px: np.ndarray,
    depth: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    camera: Intrinsics = CAMERA,
) -> np.ndarray:
    """Pixels of the first frame in the second one, by the depth at the nearest pixel."""
    column, row = np.rint(points_px).astype(int).T
    centre, focal = (camera.cx, camera.cy), (camera.fx, camera.fy)
    rays = np.column_stack([(points_px - centre) / focal, np.ones(len(points_px))])
    world = (rays * depth[row, column, None]) @ first[:3, :3].T + first[:3, 3]
    p_cam = (world - second[:3, 3]) @ second[:3, :3]
    return p_cam[:, :2] / p_cam[:, 2:] * focal + centre


def flow_errors(
    renderer: Renderer, first: np.ndarray, second: np.ndarray, camera: Intrinsics = CAMERA
) -> np.ndarray:
    """(n, 2) tracked minus predicted positions, pixels, of the first frame's corners in the second."""
    (gray_a, depth), (gray_b, _) = renderer.render(first), renderer.render(second)
    start = cv2.goodFeaturesToTrack(gray_a, 400, 0.01, 10)
    end, found, _ = cv2.calcOpticalFlowPyrLK(
        gray_a, gray_b, start, np.empty_like(start), winSize=(15, 15), criteria=(3, 50, 1e-3)
    )
    good = found[:, 0] == 1
    # A corner on an outline belongs to the nearer surface, not to the one at its own pixel.
    front = cv2.erode(depth, np.ones((3, 3), np.uint8))
    return end[good, 0] - reproject(start[good, 0], front, first, second, camera)


def check_flow(errors_px: list[np.ndarray], at_least: int) -> None:
    """Assert that (n, 2) ``flow_errors`` of several frames are many enough, small and without bias."""
    errors = np.concatenate(errors_px)
    assert len(errors) > at_least
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.1
    assert np.abs(np.median(errors, axis=0)).max() < 0.02
