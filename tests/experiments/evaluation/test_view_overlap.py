"""View overlap: known shares of simple scenes, the search for the best pair, a rendered corridor's corner."""

from dataclasses import replace

import numpy as np
import pytest
from world_views import along, cheap_textures, depth_thumbnails, length

from dslab.experiments.evaluation.view_overlap import (
    RESCUABLE_OVERLAP,
    best_overlap,
    is_rescuable,
    view_overlap,
)
from dslab.scenarios.spec import Scenario
from dslab.sim.frame_plan import render_backend
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.shared_view import seen_share
from dslab.sim.worlds import layout

CAMERA = Intrinsics(80, 60, 64.0, 64.0, 39.5, 29.5, 30.0)
ROW, COLUMN = np.mgrid[:60, :80].astype(float)
RAYS = np.stack([(COLUMN - CAMERA.cx) / CAMERA.fx, (ROW - CAMERA.cy) / CAMERA.fy, np.ones((60, 80))], -1)


def pose(x=0.0, y=0.0, z=0.0, yaw_deg=0.0) -> np.ndarray:
    """A camera in a world whose axes are those of the camera at yaw 0."""
    T, yaw = np.eye(4), np.deg2rad(yaw_deg)
    T[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T


def plane(T_world_cam: np.ndarray, normal, offset: float) -> np.ndarray:
    """Depth of the plane normal . X = offset, 0 where it is not in front."""
    normal = np.asarray(normal, float)
    with np.errstate(divide="ignore"):
        depth = (offset - normal @ T_world_cam[:3, 3]) / (RAYS @ (T_world_cam[:3, :3].T @ normal))
    return np.where((depth > 0) & (depth < 1e3), depth, 0).astype(np.float32)


def room(T_world_cam: np.ndarray) -> np.ndarray:
    """Depth inside a box 8 m x 3 m x 6 m about the origin."""
    sides = [
        (sign * axis, size / 2) for axis, size in zip(np.eye(3), (8, 3, 6), strict=True) for sign in (-1, 1)
    ]
    walls = [plane(T_world_cam, normal, offset) for normal, offset in sides]
    return np.min([np.where(wall > 0, wall, np.inf) for wall in walls], axis=0).astype(np.float32)


def overlap(scene, a: np.ndarray, b: np.ndarray) -> float:
    return view_overlap(scene(a), a, scene(b), b, CAMERA)


@pytest.mark.parametrize(
    ("moved", "share"),
    [
        (pose(), 1.0),
        (pose(x=0.5), 0.8),  # the view is 2.5 m wide at 2 m
        (pose(x=0.5, y=0.46875), 0.6),  # and 1.875 m high
        (pose(z=1.0), 0.25),  # half as far off, a quarter of the first view's wall
        (pose(x=2.6), 0.0),
    ],
)
def test_a_wall_is_shared_as_the_views_on_it_are(moved, share):
    assert overlap(lambda T: plane(T, (0, 0, 1), 2.0), pose(), moved) == pytest.approx(share, abs=0.02)


def test_the_smaller_direction_counts_whichever_is_first():
    wall = lambda T: plane(T, (0, 0, 1), 2.0)  # noqa: E731
    assert overlap(wall, pose(), pose(z=1.0)) == overlap(wall, pose(z=1.0), pose())


def test_back_to_back_in_a_room_nothing_is_shared():
    assert overlap(room, pose(), pose(yaw_deg=180)) == 0
    assert overlap(room, pose(), pose(yaw_deg=10)) > 0.6


def inside_share(depth: np.ndarray, moved: np.ndarray) -> float:
    """Share of the surface within the image after the camera's position has changed, hidden or not."""
    right, down, ahead = np.moveaxis(RAYS * depth[..., None] - moved, -1, 0)
    across = np.abs(right) * CAMERA.fx <= 40 * ahead
    return float((across & (np.abs(down) * CAMERA.fy <= 30 * ahead))[depth > 0].mean())


def test_a_floor_seen_at_a_grazing_angle_agrees():
    # Near the horizon the depths of neighbouring pixels differ by much more than 5 %.
    floor = lambda T: plane(T, (0, 1, 0), 1.5)  # noqa: E731
    a, b, moved = pose(), pose(y=0.35, z=0.3), np.array([0, 0.35, 0.3])
    expected = min(inside_share(floor(a), moved), inside_share(floor(b), -moved))
    assert overlap(floor, a, b) == pytest.approx(expected, abs=0.01)


def test_what_an_occluder_hides_is_not_shared():
    open_wall = plane(pose(), (0, 0, 1), 2.0)
    half_hidden = open_wall.copy()
    half_hidden[:, 40:] = 1.0
    assert view_overlap(open_wall, pose(), half_hidden, pose(), CAMERA) == pytest.approx(0.5, abs=0.02)


def test_the_two_faces_of_a_thin_wall_are_not_shared():
    a, b = pose(z=-3), pose(z=3.1, yaw_deg=180)
    front, back = plane(a, (0, 0, 1), 0.0), plane(b, (0, 0, 1), 0.1)
    assert view_overlap(front, a, back, b, CAMERA) == 0


def test_the_sky_does_not_count():
    half_sky = plane(pose(), (0, 0, 1), 2.0)
    half_sky[:30] = 0
    assert view_overlap(half_sky, pose(), half_sky, pose(), CAMERA) == 1
    sky = np.zeros_like(half_sky)
    assert view_overlap(sky, pose(), sky, pose(), CAMERA) == 0


def test_images_of_another_size_or_lens_are_refused():
    depth = plane(pose(), (0, 0, 1), 2.0)
    bent = replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    for image, camera in ((depth[:, :40], CAMERA), (depth, bent)):
        with pytest.raises(ValueError, match="pinhole"):
            view_overlap(image, pose(), depth, pose(), camera)


def seen_share_numpy(depth, other, R, t) -> float:
    """Twin of the kernel, over whole images."""
    points = RAYS * depth[..., None] @ R.T + t
    z = points[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = points[..., :2] / z[..., None] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
        inverse, other_inverse = 1 / depth, 1 / other.astype(float)
    valid = (depth > 0) & (z > 0) & (np.abs(at - (39.5, 29.5)) <= (40, 30)).all(-1)
    at = np.where(valid[..., None], at, 0)
    left, top = np.clip(np.floor(at).astype(int), 0, (78, 58)).transpose(2, 0, 1)
    u, v = at[..., 0] - left, at[..., 1] - top
    corners = [(i, j, (v if i else 1 - v) * (u if j else 1 - u)) for i in (0, 1) for j in (0, 1)]
    four = [(other[top + i, left + j], other_inverse[top + i, left + j], share) for i, j, share in corners]
    agrees = np.any([(d > 0) & (np.abs(d - z) <= 0.05 * z) for d, *_ in four], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        planar = 1 / sum(w * share for _, w, share in four)
        agrees |= np.all([d > 0 for d, *_ in four], axis=0) & (planar > 0) & (np.abs(planar - z) <= 0.05 * z)

        def slope(axis):
            steps = np.diff(inverse, axis=axis)
            gap = np.full_like(np.take(steps, [0], axis), np.inf)
            before, after = np.concatenate([gap, steps], axis), np.concatenate([steps, gap], axis)
            best = np.where(np.abs(after) < np.abs(before), after, before)
            return np.where(np.isfinite(best), best, 0)

        plane_of = np.stack([slope(1) * CAMERA.fx, slope(0) * CAMERA.fy, inverse], -1)
        plane_of[..., 2] -= (plane_of[..., :2] * RAYS[..., :2]).sum(-1)
        faces = plane_of @ (-R.T @ t) < 1
    return (valid & agrees & faces).sum() / (depth > 0).sum()


@pytest.mark.parametrize("seed", range(6))
def test_the_kernel_is_its_numpy_twin(seed):
    rng = np.random.default_rng(seed)
    a, b = (pose(*rng.uniform(-1, 1, 3), yaw_deg=rng.uniform(-20, 20)) for _ in range(2))
    depths = [room(T).astype(np.float32) for T in (a, b)]
    for depth in depths:  # things in the way, and holes
        row, column = rng.integers(0, 40, 2)
        depth[row : row + 15, column : column + 20] *= np.float32(0.6)
        depth[rng.random(depth.shape) < 0.02] = 0
    T_b_a = np.linalg.inv(b) @ a
    R, t = np.ascontiguousarray(T_b_a[:3, :3]), T_b_a[:3, 3].copy()
    focal, centre = np.array([64.0, 64.0]), np.array([39.5, 29.5])
    share = seen_share(*depths, R, t, focal, centre, 0.05)
    assert 0.05 < share < 1
    assert share == pytest.approx(seen_share_numpy(*map(np.float64, depths), R, t), abs=3 / 4800)


CORNER = {"kind": "corridor", "length_m": 22, "turns": 1}
WALK = Scenario.model_validate(
    {"name": "corner", "world": CORNER, "camera": {"fps": 10}, "trajectory": {"gaze_deg": 90}, "seed": 5}
)


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """Poses every 0.1 m along a corridor with a corner, looking at the left wall; folder with its shape."""
    cache = tmp_path_factory.mktemp("cache")
    route = layout(WALK.world, 5)
    T_world_cam = np.array([along(route, s, 90) for s in np.arange(0.5, length(route) - 0.5, 0.1)])
    with cheap_textures():
        depth_thumbnails(WALK, T_world_cam[:1], cache_dir=cache, backend=uncached_worlds())
    return T_world_cam, cache


def uncached_worlds():
    """A backend whose worlds with cheap textures are not kept for other tests."""
    from dslab.sim.worlds import build_world

    return replace(render_backend(), build_world=build_world)


def test_around_a_corner_nothing_is_shared_and_along_a_wall_much(walked):
    T_world_cam, cache = walked
    last = len(T_world_cam)
    along_wall = best_overlap(WALK, T_world_cam, range(30), range(33, 50), cache_dir=cache)
    assert along_wall.overlap > 0.6 and along_wall.frames == (29, 33) and is_rescuable(along_wall.overlap)
    around = best_overlap(WALK, T_world_cam, range(40), range(last - 40, last), cache_dir=cache)
    assert around.overlap < 0.02 and not is_rescuable(around.overlap)


def test_the_search_finds_the_best_of_all_pairs(walked):
    T_world_cam, cache = walked
    # There and back again, ever higher away from one place in the midst of both sides.
    back = T_world_cam[60:0:-1].copy()
    back[:, 2, 3] += 0.02 * np.abs(np.arange(60) - 17)
    poses = np.concatenate([T_world_cam[20:75], back])
    before, after = range(55), range(55, len(poses))
    depths, camera = depth_thumbnails(WALK, poses, cache_dir=cache)
    every = [view_overlap(depths[i], poses[i], depths[j], poses[j], camera) for i in before for j in after]
    found = best_overlap(WALK, poses, before, after, cache_dir=cache)
    assert max(every) - 0.005 <= found.overlap <= max(every)
    i, j = found.frames
    assert found.overlap == every[i * len(after) + j - 55]
    assert best_overlap(WALK, poses, before, after, cache_dir=cache) == found


def test_frames_without_a_pose_are_passed_over(walked):
    T_world_cam, cache = walked
    holed = T_world_cam.copy()
    holed[25:30] = np.nan
    assert best_overlap(WALK, holed, range(20, 30), range(33, 40), cache_dir=cache).frames == (24, 33)
    assert best_overlap(WALK, holed, range(25, 30), range(33, 40), cache_dir=cache) == (0.0, None)


def test_the_least_rescuable_overlap_is_a_fifth():
    assert RESCUABLE_OVERLAP == 0.2
    assert is_rescuable(0.2) and not is_rescuable(0.199)
