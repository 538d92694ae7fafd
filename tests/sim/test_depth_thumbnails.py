"""Depth thumbnails: the world's own depth, its shape kept in the cache, the camera's field of view."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from small_world import CAMERA, CORRIDOR
from world_views import cheap_textures, depth_thumbnails, poses

from dslab.scenarios.spec import Scenario
from dslab.sim.depth_thumbnails import thumbnail_camera
from dslab.sim.frame_plan import render_backend, taking_intrinsics
from dslab.sim.rendering.renderers import RENDERERS, load_renderer
from dslab.sim.sensors.distortion import unproject
from dslab.sim.worlds import build_world, layout

SCENARIO = Scenario.model_validate(
    {"name": "thumbs", "duration_s": 2, "world": CORRIDOR, "camera": CAMERA, "seed": 3}
)
BLUR = {"kind": "motion_blur", "start_s": 0.5, "duration_s": 0.5, "exposure_s": 0.1}


@pytest.fixture
def built():
    """Seeds of the worlds that ``backend`` has built."""
    return []


@pytest.fixture
def backend(built):
    def build(spec, seed):
        built.append(seed)
        with cheap_textures():
            return build_world(spec, seed)

    return replace(render_backend(), build_world=build)


@pytest.fixture
def T_world_cam() -> np.ndarray:
    return np.array(poses(layout(SCENARIO.world, 3), 5))


@pytest.mark.parametrize("kind", RENDERERS)
def test_depth_is_that_of_the_textured_world(tmp_path, backend, T_world_cam, kind):
    backend = replace(backend, renderer=load_renderer(kind))
    depths_m, camera = depth_thumbnails(SCENARIO, T_world_cam, cache_dir=tmp_path, backend=backend)
    assert depths_m.shape == (5, 53, 80) and depths_m.dtype == np.float32
    renderer = backend.renderer(backend.build_world(SCENARIO.world, 3), camera)
    expected = np.array([renderer.render(pose)[1] for pose in T_world_cam])
    renderer.close()
    assert (np.abs(depths_m - expected) > 1e-3).mean() < 1e-3


def test_the_shape_is_built_once_for_every_scenario_in_a_world(tmp_path, backend, built, T_world_cam):
    stressed = SCENARIO.model_validate(
        {**SCENARIO.model_dump(), "name": "other", "segments": [BLUR], "seed": 8, "world_seed": 3}
    )
    first, _ = depth_thumbnails(SCENARIO, T_world_cam, cache_dir=tmp_path, backend=backend)
    again, _ = depth_thumbnails(stressed, T_world_cam, cache_dir=tmp_path, backend=backend)
    assert built == [3]
    np.testing.assert_array_equal(first, again)
    depth_thumbnails(
        SCENARIO.model_copy(update={"seed": 4}), T_world_cam, cache_dir=tmp_path, backend=backend
    )
    assert built == [3, 4]


def test_a_corrupt_shape_is_built_again(tmp_path, backend, built, T_world_cam, caplog):
    first, _ = depth_thumbnails(SCENARIO, T_world_cam, cache_dir=tmp_path, backend=backend)
    (stored,) = tmp_path.glob("*/vertices_m.npy")
    stored.write_bytes(b"")
    with caplog.at_level(logging.WARNING):
        again, _ = depth_thumbnails(SCENARIO, T_world_cam, cache_dir=tmp_path, backend=backend)
    assert built == [3, 3] and "vertices_m.npy" in caplog.text
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize("k1", [0.0, -0.2])
def test_the_camera_holds_all_that_the_scenarios_sees(k1):
    distortion = {"model": "radtan", "k1": k1} if k1 else {}
    camera = SCENARIO.camera.model_validate({**CAMERA, "distortion": distortion} if distortion else CAMERA)
    small = thumbnail_camera(camera)
    assert small.is_pinhole and small.width_px == 80
    edges = np.array([[-0.5, -0.5], [95.5, -0.5], [95.5, 63.5], [-0.5, 63.5]])
    seen = unproject(taking_intrinsics(camera), edges)
    own = unproject(small, np.array([[-0.5, -0.5], [79.5, small.height_px - 0.5]]))
    slack = 0.0 if k1 else 0.01
    assert (own[0] <= seen.min(axis=0) + slack).all() and (own[1] >= seen.max(axis=0) - slack).all()
    assert np.ptp(own, axis=0) == pytest.approx(np.ptp(seen, axis=0), rel=0.15 if k1 else 0.02)
