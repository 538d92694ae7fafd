"""Every renderer: pixels where intrinsics and pose put them, metric depth, surface ids, contrast."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from dslab.scenarios.errors import InputError
from dslab.sim.rendering import mujoco_renderer
from dslab.sim.rendering.mujoco_renderer import MujocoRenderer
from dslab.sim.rendering.renderers import RENDERERS, load_renderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds.base import Surface, WorldModel

MEAN = 118.0
CAMERA = Intrinsics(640, 480, 520.0, 430.0, 290.3, 262.7, 30.0)  # off-centre, fx unlike fy
BACKGROUND, DOT = 40, 250


def quad(corner, right, down, texture: np.ndarray, label: str = "quad") -> Surface:
    corner, right, down = (np.asarray(v, float) for v in (corner, right, down))
    vertices = np.array([corner, corner + right, corner + right + down, corner + down])
    triangles = np.array([[0, 3, 2], [0, 2, 1]], np.int32)
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return Surface(vertices, triangles, uv, texture, label)


def rotation(axis: np.ndarray, angle_deg: float) -> np.ndarray:
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = np.deg2rad(angle_deg)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def pose(R: np.ndarray | None = None, t=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.eye(3) if R is None else R, t
    return T


POSES = [
    pose(),
    pose(t=(0.4, -0.3, 0.7)),
    pose(rotation((1, 2, 3), 14.0), (-0.3, 0.2, 0.5)),
    pose(rotation((0, 0, 1), 90.0), (0.1, 0.1, 1.0)),
]


@pytest.fixture(scope="module", params=RENDERERS)
def kind(request):
    """The class of every renderer."""
    return load_renderer(request.param)


@pytest.fixture(scope="module")
def dots(kind):
    """A wall 8 m square at z = 5 with a grid of square dots, as world, dot centres and renderer."""
    texture = np.full((1024, 1024), BACKGROUND, np.uint8)
    starts = np.arange(64, 1024, 128)
    for row in starts:
        for column in starts:
            texture[row : row + 8, column : column + 8] = DOT
    wall = quad((-4, -4, 5), (8, 0, 0), (0, 8, 0), texture)
    columns, rows = np.meshgrid(starts, starts)
    centres = np.stack(
        [-4 + (columns + 4) / 128, -4 + (rows + 4) / 128, np.full(rows.shape, 5.0)], -1
    ).reshape(-1, 3)
    renderer = kind(WorldModel([wall], MEAN, np.ones(1)), CAMERA)
    yield centres, renderer
    renderer.close()


def project(points: np.ndarray, T_world_cam: np.ndarray) -> np.ndarray:
    p_cam = (points - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
    return p_cam[:, :2] / p_cam[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)


def centroid_errors(gray: np.ndarray, expected_px: np.ndarray, half: int = 9) -> np.ndarray:
    """Centroid minus expectation of every dot whose window lies within the image."""
    errors = []
    for u, v in expected_px:
        x, y = round(u), round(v)
        if not (half < x < CAMERA.width_px - half - 1 and half < y < CAMERA.height_px - half - 1):
            continue
        window = gray[y - half : y + half + 1, x - half : x + half + 1].astype(float) - BACKGROUND
        ys, xs = np.mgrid[y - half : y + half + 1, x - half : x + half + 1]
        errors.append([(window * xs).sum() / window.sum() - u, (window * ys).sum() / window.sum() - v])
    return np.array(errors)


@pytest.mark.parametrize("T_world_cam", POSES)
def test_points_appear_where_intrinsics_and_pose_put_them(dots, T_world_cam):
    centres, renderer = dots
    gray, _ = renderer.render(T_world_cam)
    errors = centroid_errors(gray, project(centres, T_world_cam))
    assert len(errors) >= 10
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    assert np.abs(errors).max() < 0.1


@pytest.mark.parametrize("T_world_cam", POSES[2:])
def test_depth_is_metric_along_the_optical_axis(dots, T_world_cam):
    _, renderer = dots
    _, depth = renderer.render(T_world_cam)
    v, u = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    expected = (5.0 - T_world_cam[2, 3]) / (rays @ T_world_cam[2, :3])
    hit = depth > 0
    assert hit.mean() > 0.5
    assert np.abs(depth - expected)[hit].max() < 1e-3


def test_depth_stays_exact_along_a_kilometre(kind):
    far_wall = quad((-400, -400, 1000), (800, 0, 0), (0, 800, 0), np.full((8, 8), 90, np.uint8))
    near_wall = quad((-1, 0.2, 0.5), (2, 0, 0), (0, 2, 0), np.full((8, 8), 90, np.uint8))
    renderer = kind(WorldModel([far_wall, near_wall], MEAN, np.ones(2)), CAMERA)
    _, depth = renderer.render(pose())
    renderer.close()
    assert abs(depth[100, 320] - 1000) < 0.005
    assert abs(depth[-1, 320] - 0.5) < 1e-5


def test_pixels_without_a_surface_have_depth_zero_and_no_id(dots):
    _, renderer = dots
    away = pose(rotation((0, 1, 0), 180.0))
    assert not renderer.render(away)[1].any()
    assert (renderer.render_surface_ids(away) == -1).all()


def test_texture_rows_run_downward_and_ids_distinguish_surfaces(kind):
    left = quad(
        (-2, -1, 4), (2, 0, 0), (0, 2, 0), np.repeat([30, 220], 32)[:, None].repeat(64, 1).astype(np.uint8)
    )
    right = quad(
        (0, -1, 4), (2, 0, 0), (0, 2, 0), np.tile(np.repeat([60, 180], 32), (64, 1)).astype(np.uint8)
    )
    renderer = kind(WorldModel([left, right], MEAN, np.ones(2)), CAMERA)
    gray, _ = renderer.render(pose())
    ids = renderer.render_surface_ids(pose())
    again, _ = renderer.render(pose())
    renderer.close()
    points = np.array([[-1, -0.5, 4], [-1, 0.5, 4], [0.5, 0, 4], [1.5, 0, 4], [0, 1.5, 4]])
    u, v = np.rint(project(points, pose())).astype(int).T
    assert gray[v, u].tolist() == [30, 220, 60, 180, 0]
    assert ids[v, u].tolist() == [0, 0, 1, 1, -1]
    assert ids.dtype == np.int32
    # Surface ids must leave no trace in later frames.
    np.testing.assert_array_equal(gray, again)


@pytest.mark.parametrize("contrast", [1.0, 0.05])
def test_contrast_fades_levels_about_the_mean(kind, contrast):
    levels = (20, 100, 240)
    surfaces = [
        quad((k - 1.5, -1, 3), (1, 0, 0), (0, 2, 0), np.full((8, 8), g, np.uint8))
        for k, g in enumerate(levels)
    ]
    renderer = kind(WorldModel(surfaces, MEAN, np.full(3, contrast)), CAMERA)
    gray, _ = renderer.render(pose())
    renderer.close()
    centres = np.array([[k - 1.0, 0, 3] for k in range(3)])
    u, v = np.rint(project(centres, pose())).astype(int).T
    assert gray[v, u].tolist() == [round(MEAN + contrast * (g - MEAN)) for g in levels]


def test_a_surface_is_seen_from_its_front_only(dots):
    _, renderer = dots
    behind = pose(rotation((0, 1, 0), 180.0), (0, 0, 9))
    assert not renderer.render(behind)[1].any()


def test_repeated_frames_are_equal_and_independent(dots):
    _, renderer = dots
    first, first_depth = renderer.render(POSES[2])
    kept = first.copy()
    renderer.render(POSES[1])
    again, again_depth = renderer.render(POSES[2])
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first_depth, again_depth)


def test_two_renderers_of_different_sizes_alternate(kind, dots):
    _, renderer = dots
    before, _ = renderer.render(POSES[0])
    wall = quad((-4, -4, 5), (8, 0, 0), (0, 8, 0), np.full((8, 8), 77, np.uint8))
    other = kind(WorldModel([wall], MEAN), Intrinsics(320, 200, 300.0, 300.0, 159.5, 99.5, 30.0))
    gray, depth = other.render(pose())
    assert gray.shape == depth.shape == (200, 320) and (gray == 77).all()
    np.testing.assert_array_equal(renderer.render(POSES[0])[0], before)
    other.close()
    np.testing.assert_array_equal(renderer.render(POSES[0])[0], before)


def test_a_world_of_more_surfaces_than_one_context_takes_looks_the_same(monkeypatch):
    rng = np.random.default_rng(0)
    surfaces = [
        quad(
            (*rng.uniform(-2, 1, 2), rng.uniform(2, 5)),
            (1, 0, 0.3),
            (0, 1, -0.2),
            np.full((8, 8), 20 + 9 * k, np.uint8),
        )
        for k in range(24)
    ]
    behind = [quad((-1, -1, -5), (1, 0, 0), (0, 1, 0), np.full((8, 8), 5, np.uint8))] * 3
    world = WorldModel([*surfaces[:12], *behind, *surfaces[12:]], MEAN)
    frames = []
    for most in (999, 5):
        monkeypatch.setattr(mujoco_renderer, "MOST_SURFACES", most)
        renderer = MujocoRenderer(world, CAMERA)
        frames.append((*renderer.render(POSES[1]), renderer.render_surface_ids(POSES[1])))
        renderer.close()
    assert len(np.unique(frames[0][2])) > 10
    for split in frames[1:]:
        for one, other in zip(frames[0], split, strict=True):
            np.testing.assert_array_equal(one, other)


def test_distortion_is_refused(kind):
    distorted = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, 30.0, (0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="distortion"):
        kind(WorldModel([], MEAN), distorted)


_FRAME = """
import hashlib, numpy as np
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.rendering.renderers import load_renderer
from dslab.sim.worlds.base import Surface, WorldModel
texture = np.random.default_rng(3).integers(0, 256, (512, 512), dtype=np.uint8)
vertices = np.array([[-4.0, -4, 5], [4, -4, 5], [4, 4, 6], [-4, 4, 6]])
uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
surface = Surface(vertices, np.array([[0, 3, 2], [0, 2, 1]], np.int32), uv, texture, "wall")
camera = Intrinsics(640, 480, 520.0, 430.0, 290.3, 262.7, 30.0)
renderer = load_renderer(name)(WorldModel([surface], 118.0), camera)
gray, depth = renderer.render(np.eye(4))
digest = hashlib.sha256(gray.tobytes() + depth.tobytes()).hexdigest()
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", RENDERERS)
def test_another_process_renders_the_same_bytes(name):
    here: dict = {"name": name}
    exec(_FRAME, here)
    here["renderer"].close()
    assert here["gray"].std() > 20
    code = f"name = {name!r}\n" + _FRAME + "print(digest)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == here["digest"]
    assert len(here["digest"]) == 2 * hashlib.sha256().digest_size
