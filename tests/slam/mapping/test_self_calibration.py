"""A system fed with images of a lens that distorts more than its calibration says."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.slam.config import default_config
from dslab.slam.core.camera import Residual, undistort_residual
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.factory import build_system
from dslab.slam.mapping.self_calibration import SelfCalibrationConfig
from dslab.slam.runtime.backend import ExecutionMode
from dslab.slam.toy_sequence import CAMERA, toy_frames

PLANTED = (0.06, 0.0, 0.0, 0.0)
CONFIG = replace(default_config(CAMERA), self_calibration=SelfCalibrationConfig(at_keyframes=(12,)))


def through_lens(residual: Residual, count: int = 75) -> Iterator[tuple[np.ndarray, float]]:
    """Toy frames as a lens with a residual distortion shows them."""
    rows, cols = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    seen = np.stack([cols.ravel(), rows.ravel()], axis=1).astype(float)
    ideal = undistort_residual(seen, residual, CAMERA.intrinsics).astype(np.float32)
    x, y = ideal.reshape(*rows.shape, 2).transpose(2, 0, 1)
    for image, stamp_s, _ in toy_frames(count, step_m=0.05):
        yield cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), stamp_s


@pytest.mark.parametrize(
    ("kind", "mode"), [("base", "lockstep"), ("dual", "lockstep"), ("base", "threaded"), ("dual", "threaded")]
)
@pytest.mark.slow
def test_a_refined_lens_is_taken_out_of_map_and_buffer(kind: str, mode: str):
    # This scene hardly determines the lens: any estimate is applied here.
    always = SelfCalibrationConfig(at_keyframes=(6,), min_significance=0.0, min_shift_px=0.0)
    config = replace(CONFIG, self_calibration=always)
    system = build_system(kind, CAMERA, config=config, mode=ExecutionMode(mode))
    for image, stamp_s in through_lens(PLANTED):
        assert system.process(image, stamp_s).frame == 0 or not system.maps() or system.state == "tracking"
    system.finish()
    assert [e.kind for e in system.events] == ["initialized", "camera_refined"]
    assert any(system.camera.residual)
    m = system.current_map
    assert len(m.keyframes()) > 8
    for k in m.keyframes():
        expected = system.camera.undistort_points(m.features(int(k)).xy_image)
        assert m.arrays.kp_xy[m.keypoints(int(k))] == pytest.approx(expected, abs=0.01)
    if isinstance(system, DualSlam):
        for features in system.buffer.backward_from(10**6):
            assert np.array_equal(features.xy, system.camera.undistort_points(features.xy_image))


def test_a_calibrated_lens_is_left_alone():
    system = build_system("base", CAMERA, config=CONFIG)
    for image, stamp_s, _ in toy_frames(90, step_m=0.05):
        system.process(image, stamp_s)
    assert system.current_map.n_keyframes > 12
    assert [e.kind for e in system.events] == ["initialized"]
    assert system.camera == CAMERA


@pytest.mark.slow
def test_once_known_to_be_off_a_lens_follows_every_estimate():
    """The first estimate must be worth it; those that follow change less than the first one had to."""

    def shifts_px(least_px: float) -> list[float]:
        always = SelfCalibrationConfig(at_keyframes=(7, 9), min_significance=0.0, min_shift_px=least_px)
        system = build_system("base", CAMERA, config=replace(CONFIG, self_calibration=always))
        for image, stamp_s in through_lens(PLANTED):
            system.process(image, stamp_s)
        return [e.shift_px for e in system.events if e.kind == "camera_refined"]

    first, later = shifts_px(0.0)
    assert later < first
    assert shifts_px((first + later) / 2) == [first, later]


def shaken(readout_s: float, count: int = 75) -> Iterator[tuple[np.ndarray, float]]:
    """Toy frames of a camera that is shaken, read row by row."""
    rows, cols = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    across, down = (cols - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy
    rays = np.stack([across, down, np.ones(rows.shape)], axis=2)
    since_s = readout_s * ((np.arange(CAMERA.height_px) + 0.5) / CAMERA.height_px - 0.5)
    for image, stamp_s, _ in toy_frames(count, step_m=0.05):
        t = stamp_s + since_s
        turn = np.stack([0.03 * np.sin(11 * t), 0.04 * np.sin(8 * t), 0.06 * np.sin(6.5 * t)], axis=1)
        R = Rotation.from_rotvec(turn).as_matrix().astype(np.float32)
        seen = np.einsum("rij,rcj->rci", R, rays.astype(np.float32))
        x = seen[..., 0] / seen[..., 2] * CAMERA.fx + CAMERA.cx
        y = seen[..., 1] / seen[..., 2] * CAMERA.fy + CAMERA.cy
        yield cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), stamp_s


@pytest.mark.parametrize("readout_s", [0.025, 0.0])
@pytest.mark.slow
def test_a_rolling_shutter_is_found_where_there_is_one(readout_s: float):
    at = SelfCalibrationConfig(at_keyframes=(12,))
    system = build_system("base", CAMERA, config=replace(default_config(CAMERA), self_calibration=at))
    off_rad_s = []
    for image, stamp_s in shaken(readout_s):
        assert system.process(image, stamp_s).frame == 0 or not system.maps() or system.state == "tracking"
        if system.camera.readout_s:
            tracker = system.tracker
            off_rad_s.append(np.abs(tracker.last.features.twist - tracker.twist)[3:].max())
    assert system.camera.readout_s == pytest.approx(readout_s, rel=0.2)
    assert np.median(off_rad_s or 0.0) < 0.055  # by a frame's own motion; by that of the one before .075
    m = system.current_map
    for k in m.keyframes():
        f = m.features(int(k))
        assert m.arrays.kp_xy[m.keypoints(int(k))] == pytest.approx(
            system.camera.ideal_points(f.xy_image, f.twist), abs=0.01
        )
