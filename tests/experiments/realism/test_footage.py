"""``dslab footage``: statistics with known answers, the page, one line per fault."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from slam_scenes import CAMERA as SLAM_CAMERA
from slam_scenes import random_map, scene
from small_world import CAMERA, CORRIDOR

from dslab.experiments.realism.compare import _described
from dslab.experiments.realism.measures import MEASURES, frame_statistics, live_residuals, map_statistics


def image(noise=1.0, blur_px=0.0, seed=0):
    """Random blocks with flat ground below, blurred and then noisy."""
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.uniform(60, 190, (20, 40)), np.ones((8, 8)))
    levels = np.vstack([blocks, np.full((80, 320), 120.0)])
    if blur_px:
        levels = cv2.GaussianBlur(levels, (0, 0), blur_px)
    return np.clip(np.rint(levels + noise * rng.standard_normal(levels.shape)), 0, 255).astype(np.uint8)


def test_the_noise_of_even_areas_is_found():
    for sigma in (1.0, 2.5):
        assert frame_statistics(image(sigma))["noise"][0] == pytest.approx(sigma, rel=0.15)


def test_blur_lowers_sharpness_and_empty_ground_leaves_tiles_empty():
    sharp, soft = frame_statistics(image()), frame_statistics(image(blur_px=1.0))
    assert soft["sharpness"][0] < 0.7 * sharp["sharpness"][0]
    assert 0.2 < sharp["empty_tiles"][0] < 0.45


def test_shares_of_clipped_pixels():
    levels = np.full((64, 64), 100, np.uint8)
    levels[:16], levels[-8:] = 0, 255
    found = frame_statistics(levels)
    assert found["clipped_dark"][0] == 0.25 and found["clipped_bright"][0] == 0.125


def test_distance_of_distributions_has_known_ends():
    a = np.arange(100.0)
    for shift, asked in ((0, 0), (1000, 1), (50, 0.5)):
        assert _described(a + shift, a)["distance"] == pytest.approx(asked)
    assert _described(np.empty(0), a) == {"values": 0, "quantiles": None, "distance": None}


def test_observations_of_an_exact_map_have_no_residual_and_a_planted_one_its_size():
    m, frame = scene(np.random.default_rng(0))
    m.arrays.kp_point[: len(frame.point)] = frame.point
    assert map_statistics(m)["residual"].max() < 1e-6
    scale = m.view.scale[frame.features.octave[7]]
    m.arrays.kp_xy[7, 0] += 3 * scale
    found = map_statistics(m)
    assert found["residual"][7] == pytest.approx(3) and len(found["found"]) == len(m.points())


def test_every_observation_counts_and_the_descriptors_own_is_no_comparison():
    m = random_map(np.random.default_rng(1))
    observations = int((m.arrays.kp_point[: m.arrays.kf_start[m.n_keyframes]] >= 0).sum())
    found = map_statistics(m)
    assert found["track_length"].sum() == observations
    assert len(found["descriptor_distance"]) < observations and found["descriptor_distance"].min() > 0


def test_live_residuals_keep_what_the_tracker_removes_and_change_nothing():
    m, frame = scene(np.random.default_rng(0))
    f, T = frame.features, np.eye(4)
    m.arrays.kp_point[: len(frame.point)] = frame.point
    frame.T_cam_map = T
    system = SimpleNamespace(
        current_map=m, tracker=SimpleNamespace(last=frame, config=SimpleNamespace(local_map_keyframes=5))
    )
    exact = live_residuals(system)
    assert len(exact) > 300 and np.quantile(exact, 0.9) < 1e-6
    # Points beside their keypoints by four sigma, which are matched all the same.
    row = np.flatnonzero(f.octave == 2)[:20]
    shift = 4 * m.view.scale[2] / SLAM_CAMERA.fx
    m.arrays.pt_xyz[frame.point[row], 0] += shift * m.arrays.pt_xyz[frame.point[row], 2]
    before = m.arrays.pt_visible.copy()
    moved = live_residuals(system)
    assert ((moved > 3.9) & (moved < 4.1)).sum() > 10
    np.testing.assert_array_equal(m.arrays.pt_visible, before)


@pytest.fixture
def scenario_file(tmp_path):
    spec = {"name": "tiny", "duration_s": 1.2, "world": CORRIDOR, "camera": CAMERA}
    (tmp_path / "tiny.yaml").write_text(json.dumps(spec))
    return tmp_path / "tiny.yaml"


@pytest.mark.slow
def test_picture_and_figures_even_where_nothing_is_tracked(dslab, tmp_path, scenario_file):
    code, out, _ = dslab("footage", scenario_file, "--out", tmp_path / "out")
    assert code == 0 and "footage.png" in out
    content = json.loads((tmp_path / "out" / "footage.json").read_text())[str(scenario_file)]
    assert content["figures"]["frames"] == 12 and list(content["measures"]) == list(MEASURES)
    noise, residual = (content["measures"][name] for name in ("noise", "residual"))
    assert noise["values"] == 2 and noise["distance"] == 0 and residual["quantiles"] is None
    assert cv2.imread(str(tmp_path / "out" / "footage.png")).std() > 10


def test_bad_input_is_one_line(dslab, tmp_path, scenario_file):
    code, _, err = dslab("footage", scenario_file, scenario_file, "--out", tmp_path / "out")
    assert code == 2 and len(err.strip().splitlines()) == 1 and "named twice" in err
    assert dslab("footage", "no-such-thing", "--out", tmp_path / "out")[0] == 2
    assert not (tmp_path / "out").exists()
