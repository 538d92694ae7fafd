"""Motion blur of 24 pixels in rendered worlds, against the mean of frames rendered during the exposure."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.worlds import CityWorld, CorridorWorld, RoomWorld
from dslab.sim.frame_plan import render_backend
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.exposure import expose
from dslab.sim.sensors.tone import linear_to_srgb, srgb_to_linear

CAMERA = Intrinsics(480, 360, 315.0, 315.0, 239.5, 179.5, 30.0)
BLUR_PX, SUB_FRAMES, SEED, EYE_M = 24.0, 48, 3, 1.5
WORLDS = {
    "room": RoomWorld(length_m=7, width_m=6),
    "corridor": CorridorWorld(length_m=14, turns=0),
    "city": CityWorld(length_m=100, turns=0),
}
# Offset and rotation vector over the exposure in the camera's frame, up to the factor that gives the blur.
MOTIONS = {
    "turning": ((0.0, 0.0, 0.0), (0.1, 1.0, 0.5)),
    "sideways": ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "ahead": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
    "ahead and turning": ((0.0, 0.2, 1.0), (0.05, 0.25, 0.1)),
}
LEAST_DB = 40.0


@pytest.fixture
def stage(request):
    """A world's renderer and a pose a third along its route, looking ahead."""
    backend, spec = render_backend(), WORLDS[request.param]
    line = backend.layout(spec, SEED).centre_m
    at = len(line) // 3
    forward = np.append(line[at + 1] - line[at], 0) / np.linalg.norm(line[at + 1] - line[at])
    T_world_cam = np.eye(4)
    T_world_cam[:3, :3] = np.column_stack([np.cross([0, 0, -1], forward), [0, 0, -1], forward])
    T_world_cam[:3, 3] = [*line[at], EYE_M]
    renderer = backend.renderer(backend.build_world(spec, SEED), CAMERA)
    yield renderer, T_world_cam
    renderer.close()


def moved(offset_m: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn_rad).as_matrix(), offset_m
    return T


def psnr_db(image: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.mean((image - truth)[inside] ** 2)))


def seen_inside(depth_m: np.ndarray, T_mid_cam: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels of a frame during the exposure that see what lies in the sharp frame's view."""
    rows, columns = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    rays = np.stack([(columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy, np.ones(rows.shape)])
    points = np.einsum("ij,jhw->ihw", T_mid_cam[:3, :3], rays * np.where(depth_m > 0, depth_m, 1e4))
    points += T_mid_cam[:3, 3, None, None]
    x, y = CAMERA.fx * points[0] / points[2] + CAMERA.cx, CAMERA.fy * points[1] / points[2] + CAMERA.cy
    return (x >= 0) & (y >= 0) & (x <= CAMERA.width_px - 1) & (y <= CAMERA.height_px - 1)


@pytest.mark.parametrize(
    ("stage", "name"),
    [
        ("room", "ahead and turning"),
        pytest.param("corridor", "sideways", marks=pytest.mark.slow),
        pytest.param("corridor", "ahead", marks=pytest.mark.slow),
        pytest.param("city", "turning", marks=pytest.mark.slow),
    ],
    indirect=["stage"],
)
@pytest.mark.slow
def test_blur_of_24_pixels_is_the_mean_of_rendered_frames(stage, name):
    renderer, T_world_cam = stage
    offset_m, turn_rad = (np.array(part) for part in MOTIONS[name])
    sharp, depth_m = renderer.render(T_world_cam)

    def blurred(size: float) -> tuple[np.ndarray, float]:
        opening, closing = (moved(s * size * offset_m, s * size * turn_rad) for s in (-0.5, 0.5))
        return expose(sharp, depth_m, CAMERA, opening, closing)

    size = 0.02
    for _ in range(4):
        size *= BLUR_PX / blurred(size)[1]
    image, length_px = blurred(size)
    assert length_px == pytest.approx(BLUR_PX, abs=0.2)

    # Light from outside the sharp frame is unknown: such pixels and a border are left out.
    light, inside = np.zeros(sharp.shape), np.zeros(sharp.shape, bool)
    border = int(BLUR_PX)
    inside[border:-border, border:-border] = True
    for s in size * ((np.arange(SUB_FRAMES) + 0.5) / SUB_FRAMES - 0.5):
        T_mid_cam = moved(s * offset_m, s * turn_rad)
        rendered, rendered_depth_m = renderer.render(T_world_cam @ T_mid_cam)
        light += srgb_to_linear(rendered / 255)
        inside &= seen_inside(rendered_depth_m, T_mid_cam)
    truth = 255 * linear_to_srgb(light / SUB_FRAMES)
    assert inside.mean() > 0.75
    assert psnr_db(sharp, truth, inside) < 26
    assert psnr_db(image, truth, inside) >= LEAST_DB
