"""Turns that no step-by-step alignment follows."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.direct.pyramid import Rectifier
from dslab.slam.direct.turn import level_of, turn_between
from dslab.slam.factory import build_system

SIDE_PX, FOCAL_PX = 2000, 300.0


@pytest.fixture(scope="module")
def wall():
    """(SIDE, SIDE) uint8 far wall, one radian of it as wide as the focal length."""
    rng, image = np.random.default_rng(3), np.zeros((SIDE_PX, SIDE_PX), np.float32)
    for size in (4, 12, 40):
        noise = rng.normal(0, 1, (SIDE_PX // size, SIDE_PX // size)).astype(np.float32)
        image += cv2.resize(noise, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_CUBIC)
    return np.clip(120 + 35 * image, 0, 255).astype(np.uint8)


def view(wall, camera, R_cam_world, shift_m=0.0):
    """What a camera sees of the wall, three metres away, from a place beside the origin."""
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    middle = SIDE_PX / 2
    to_world = np.array(
        [[1 / FOCAL_PX, 0, -middle / FOCAL_PX], [0, 1 / FOCAL_PX, -middle / FOCAL_PX], [0, 0, 1]]
    )
    shift = np.eye(3)
    shift[0, 2] = -shift_m / 3.0
    H = K @ R_cam_world @ shift @ to_world
    return cv2.warpPerspective(wall, H, (camera.width_px, camera.height_px))


CAMERA = PinholeCamera(width_px=320, height_px=240, fx=250.0, fy=250.0, cx=159.5, cy=119.5, fps=15.0)


@pytest.mark.parametrize("degrees", [(0, 4, 0), (0, 17, 0), (0, -24, 0), (9, 12, 0), (0, 15, 5)])
def test_a_turn_is_found_to_a_degree_or_two(wall, degrees):
    R = Rotation.from_rotvec(np.deg2rad(degrees))
    small = PinholeCamera(width_px=80, height_px=60, fx=62.5, fy=62.5, cx=39.5, cy=29.5, fps=15.0)
    smooth = cv2.GaussianBlur(wall, (0, 0), 4.0)
    images = [view(smooth, small, Q).astype(np.float32) for Q in (np.eye(3), R.as_matrix())]
    images[1][:3] = np.nan
    T = turn_between(images[0], images[1], np.array([62.5, 62.5, 39.5, 29.5]))
    about_axis = abs(degrees[2])
    off = np.rad2deg((Rotation.from_matrix(T[:3, :3]) * R.inv()).magnitude())
    assert off < 1.5 + about_axis and not T[:3, 3].any()


@pytest.mark.parametrize("value", [0.0, 255.0])
def test_an_image_without_contrast_tells_no_turn(value):
    blank, other = np.full((60, 80), value, np.float32), np.eye(60, 80, dtype=np.float32)
    for images in ((blank, other), (other, blank), (blank, blank)):
        np.testing.assert_array_equal(turn_between(*images, np.array([62.5, 62.5, 39.5, 29.5])), np.eye(4))


@pytest.mark.parametrize(("width", "height", "level"), [(320, 240, 2), (640, 480, 3), (60, 50, 0)])
def test_the_level_is_the_coarsest_that_still_shows_something(width, height, level):
    camera = PinholeCamera(width, height, 250.0, 250.0, (width - 1) / 2, (height - 1) / 2, 15.0)
    assert level_of(Rectifier(camera).pyramid(np.zeros((height, width), np.uint8))) == level


def test_a_camera_that_turns_by_a_third_of_its_view_between_two_images_is_tracked(wall):
    system = build_system("dso", CAMERA, 0)
    turned = np.zeros(60)
    turned[40:] = np.deg2rad(20.0)
    poses = []
    for k, angle in enumerate(turned):
        R = Rotation.from_euler("xyz", [0.02 * np.sin(0.3 * k), angle, 0.0]).as_matrix()
        poses.append(R)
        system.process(view(wall, CAMERA, R, shift_m=0.03 * k), k / 15)
    assert [e.kind for e in system.events] == ["initialized"]
    path = system.trajectories()[0]
    got = dict(zip(path.frames.tolist(), path.T_map_cam[:, :3, :3], strict=True))
    step = Rotation.from_matrix(got[39].T @ got[40])
    true = Rotation.from_matrix(poses[39] @ poses[40].T)
    assert np.rad2deg((step * true.inv()).magnitude()) < 0.3
