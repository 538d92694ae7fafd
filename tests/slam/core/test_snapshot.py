"""Snapshots: branches go on bit for bit, and nothing leaks between them."""

import numpy as np
import pytest
from dual_scenes import CONFIG, STEP_M
from slam_scenes import blanked, feed, fingerprint, toy

from slam.factory import build_system
from slam.warmup import CAMERA

# Cuts: seeking a map, tracking, just broken, seeking the second map, after the fusion.
CUTS = (2, 40, 51, 58, 110)
COUNT = 120


@pytest.fixture(scope="module", params=["base", "dual"])
def cut(request):
    """A run with a breakage, its snapshots, and what the whole run gave."""
    images, stamps_s, _ = toy(COUNT, 0, STEP_M)
    images = blanked(images, range(50, 56))
    system = build_system(request.param, CAMERA, 0, CONFIG)
    snapshots, results = {}, []
    for i, (image, stamp_s) in enumerate(zip(images, stamps_s, strict=True)):
        if i in CUTS:
            snapshots[i] = system.snapshot()
        results.append(system.process(image, stamp_s))
    return system, snapshots, results, images, stamps_s


@pytest.mark.parametrize("at", CUTS)
def test_a_branch_goes_on_bit_for_bit(cut, at):
    system, snapshots, results, images, stamps_s = cut
    assert snapshots[at].frames == at
    branch = snapshots[at].restore()
    again = feed(branch, images[at:], stamps_s[at:], check=False)
    assert fingerprint(branch) == fingerprint(system)
    for r, q in zip(results[at:], again, strict=True):
        assert (r.frame, r.state, r.inliers, r.reason) == (q.frame, q.state, q.inliers, q.reason)
        assert r.T_map_cam is None or r.T_map_cam.tobytes() == q.T_map_cam.tobytes()


def test_branches_do_not_reach_each_other_nor_the_snapshot(cut):
    _, snapshots, _, images, stamps_s = cut
    snapshot = snapshots[40]
    untouched = fingerprint(snapshot.restore())
    one, two = snapshot.restore(), snapshot.restore()
    feed(one, images[40:70], stamps_s[40:70], check=False)
    dark = np.zeros_like(images[40])
    feed(two, [dark] * 20, stamps_s[40:60], check=False)
    assert fingerprint(one) != fingerprint(two)
    assert fingerprint(snapshot.restore()) == untouched


def test_features_are_shared_and_maps_are_not(cut):
    _, snapshots, *_ = cut
    one, two = snapshots[40].restore(), snapshots[40].restore()
    a, b = one.current_map, two.current_map
    assert a.features(0) is b.features(0)
    for mine, theirs in zip(a.arrays, b.arrays, strict=True):
        assert not np.shares_memory(mine, theirs)


@pytest.mark.parametrize("at", [2, 40])
def test_dual_slam_goes_on_as_the_base_bit_for_bit(at):
    images, stamps_s, _ = toy(90, 0, STEP_M)
    images = blanked(images, range(50, 56))
    from_start, dual = (build_system(kind, CAMERA, 0, CONFIG) for kind in ("base", "dual"))
    feed(from_start, images, stamps_s, check=False)
    feed(dual, images[:at], stamps_s[:at], check=False)
    before = fingerprint(dual)
    base = dual.snapshot().restore().as_base()
    assert type(base) is type(from_start)
    feed(base, images[at:], stamps_s[at:], check=False)
    assert fingerprint(base) == fingerprint(from_start)
    assert any(e.kind == "breakage" for e in base.events)
    assert fingerprint(dual) == before  # nothing has leaked back


def test_once_they_have_parted_there_is_no_base_to_be_had():
    images, stamps_s, _ = toy(60, 0, STEP_M)
    dual = build_system("dual", CAMERA, 0, CONFIG)
    feed(dual, blanked(images, range(50, 56)), stamps_s, check=False)
    with pytest.raises(RuntimeError, match="differ from the first breakage on"):
        dual.as_base()
