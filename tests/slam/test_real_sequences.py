"""The base system on recorded sequences against their ground truth; skipped without them."""

from pathlib import Path

import numpy as np
import pytest
from slam_scenes import errors_m, feed, kinds, rms

from dslab.sim.io.forms import load_sequence
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.factory import build_system
from dslab.slam.map.invariants import check_map

DATA = Path(__file__).parents[2].parent / "shared" / "data"


def run(name, count, kind="base"):
    """The first frames of a sequence: the system, its results, the truth."""
    if not (DATA / name).is_dir():
        pytest.skip(f"no {DATA / name}")
    sequence = load_sequence(DATA / name)
    c = sequence.camera
    camera = PinholeCamera(c.width_px, c.height_px, c.fx, c.fy, c.cx, c.cy, c.fps)
    assert sequence.T_world_cam is not None
    system = build_system(kind, camera, 0)
    images = (sequence.frames[i] for i in range(count))
    results = feed(system, images, sequence.stamps_s[:count], check=False)
    for map_id in system.maps():
        check_map(system.map(map_id))
    return system, results, sequence.T_world_cam


@pytest.mark.slow
def test_a_drive_is_tracked():
    system, results, T_world_cam = run("kitti07_160", 160)
    assert sum(r.state is TrackingState.TRACKING for r in results) >= 150
    path = system.trajectories()[0]
    errors, _ = errors_m(path, T_world_cam)
    assert len(path.frames) >= 150
    # Of about 90 m.
    assert rms(errors) < 0.6


@pytest.mark.slow
def test_a_walk_through_a_kitchen_is_tracked():
    system, results, T_world_cam = run("sevenscenes_redkitchen", 400)
    assert results[-1].state is TrackingState.TRACKING
    assert set(kinds(system)) == {"initialized", "camera_refined"}
    path = system.trajectories()[0]
    assert path.frames[-1] == 399 and len(path.frames) >= 360
    assert np.isfinite(T_world_cam[path.frames]).all()
    assert rms(errors_m(path, T_world_cam)[0]) < 0.08
