"""Depth and pose against optical flow in every world, over several seeds."""

import cv2
import numpy as np
import pytest

from scenarios.worlds import (
    BuildingWorld,
    CityWorld,
    CorridorWorld,
    FieldWorld,
    MotorwayWorld,
    RoomWorld,
    WarehouseWorld,
)
from sim.camera import Intrinsics
from sim.filming import mujoco_studio
from sim.world import WORLDS

CAMERA = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0)
SPECS = {
    "room": RoomWorld(length_m=6, width_m=6),
    "corridor": CorridorWorld(length_m=16, turns=1),
    "building": BuildingWorld(floors=2, length_m=18),
    "city": CityWorld(length_m=100, turns=0),
    "motorway": MotorwayWorld(length_m=200),
    "field": FieldWorld(size_m=40),
    "warehouse": WarehouseWorld(length_m=12, aisles=2, height_m=5),
}
PAIRS, STEP_M, TURN_RAD, EYE_M = 5, 0.05, 0.017, 1.5


def test_every_registered_world_is_tested():
    assert set(SPECS) == set(WORLDS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("kind", SPECS)
def test_tracks_end_where_depth_and_pose_put_them(kind, seed):
    studio, spec = mujoco_studio(), SPECS[kind]
    route = studio.layout(spec, seed)
    floor_m = np.zeros(len(route.centre_m)) if route.height_m is None else route.height_m
    line = np.column_stack([route.centre_m, floor_m + EYE_M])
    renderer = studio.renderer(studio.build_world(spec, seed), CAMERA)
    errors = []
    for at in np.linspace(0.1, 0.8, PAIRS) * (len(line) - 1):
        here, way = line[int(at)], line[int(at) + 1] - line[int(at)]
        heading = float(np.arctan2(way[1], way[0]))
        first = level(here, heading)
        second = level(here + STEP_M * way / np.linalg.norm(way[:2]), heading + TURN_RAD)
        errors.append(track_errors(renderer, first, second))
    renderer.close()
    errors = np.concatenate(errors)
    assert len(errors) > 800
    assert np.median(np.linalg.norm(errors, axis=1)) <= 0.1
    assert np.abs(np.median(errors, axis=0)).max() < 0.02


def level(at_m: np.ndarray, heading_rad: float) -> np.ndarray:
    """(4, 4) pose of a level camera."""
    forward = np.array([np.cos(heading_rad), np.sin(heading_rad), 0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.cross([0, 0, -1], forward), [0, 0, -1], forward])
    T[:3, 3] = at_m
    return T


def track_errors(renderer, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, 2) pixels from where depth and poses put corners to where they are tracked to."""
    (gray_a, depth_m), (gray_b, _) = renderer.render(first), renderer.render(second)
    start = cv2.goodFeaturesToTrack(gray_a, 400, 0.01, 10)
    end, found, _ = cv2.calcOpticalFlowPyrLK(
        gray_a, gray_b, start, np.empty_like(start), winSize=(15, 15), criteria=(3, 50, 1e-3)
    )
    a, b = start[found[:, 0] == 1, 0], end[found[:, 0] == 1, 0]
    centre, focal = (CAMERA.cx, CAMERA.cy), (CAMERA.fx, CAMERA.fy)
    rays = np.column_stack([(a - centre) / focal, np.ones(len(a))])
    # A corner on an outline belongs to what stands in front.
    nearest_m = cv2.erode(np.where(depth_m > 0, depth_m, np.float32(1e6)), np.ones((3, 3), np.uint8))
    column, row = np.rint(a).astype(int).T
    world = rays * nearest_m[row, column, None] @ first[:3, :3].T + first[:3, 3]
    p_cam = (world - second[:3, 3]) @ second[:3, :3]
    return b - (p_cam[:, :2] / p_cam[:, 2:] * focal + centre)
