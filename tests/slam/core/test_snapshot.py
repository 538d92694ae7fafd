"""Snapshots: branches continue bit for bit and are independent of each other."""

import numpy as np
import pytest
from dual_scenes import CONFIG, STEP_M
from slam_scenes import blanked, feed, fingerprint, toy

from dslab.slam.dual.config import DualConfig
from dslab.slam.factory import build_system
from dslab.slam.toy_sequence import CAMERA

# Cuts: initializing, tracking, just broken, initializing the second map, after the fusion.
CUTS = (2, 40, 51, 58, 110)
COUNT = 116


@pytest.fixture(scope="module")
def sequence():
    images, stamps_s, _ = toy(COUNT, 0, STEP_M)
    return blanked(images, range(50, 56)), stamps_s


@pytest.fixture(scope="module")
def runs(sequence):
    """Runs of both systems with a breakage: the snapshots, that at the end too, and the results."""
    snapshots, results = {}, {}
    for kind in ("base", "dual"):
        system = build_system(kind, CAMERA, 0, CONFIG, dual=DualConfig(relocalization=False))
        snapshots[kind], results[kind] = {}, []
        for i, (image, stamp_s) in enumerate(zip(*sequence, strict=True)):
            if i in CUTS:
                snapshots[kind][i] = system.snapshot()
            results[kind].append(system.process(image, stamp_s))
        snapshots[kind][COUNT] = system.snapshot()
    assert [e.kind for e in system.events][-1] == "fusion"
    return snapshots, results


@pytest.mark.parametrize("at", CUTS)
@pytest.mark.parametrize("kind", ["base", "dual"])
@pytest.mark.slow
def test_a_branch_continues_bit_for_bit_to_the_next_cut(runs, sequence, kind, at):
    (snapshots, results), (images, stamps_s) = (each[kind] for each in runs), sequence
    assert snapshots[at].frames == at
    branch, end = snapshots[at].restore(), min(i for i in snapshots if i > at)
    again = feed(branch, images[at:end], stamps_s[at:end], check=False)
    assert fingerprint(branch) == fingerprint(snapshots[end].restore())
    for r, q in zip(results[at:end], again, strict=True):
        assert (r.frame, r.state, r.inliers, r.reason) == (q.frame, q.state, q.inliers, q.reason)
        assert r.T_map_cam is None or r.T_map_cam.tobytes() == q.T_map_cam.tobytes()


def test_branches_are_independent_of_each_other_and_of_the_snapshot(runs, sequence):
    images, stamps_s = sequence
    for kind in ("base", "dual"):
        snapshot = runs[0][kind][40]
        untouched = fingerprint(snapshot.restore())
        one, two = snapshot.restore(), snapshot.restore()
        feed(one, images[40:56], stamps_s[40:56], check=False)
        feed(two, [np.zeros_like(images[40])] * 10, stamps_s[40:50], check=False)
        assert fingerprint(one) != fingerprint(two)
        assert fingerprint(snapshot.restore()) == untouched


def test_features_are_shared_and_maps_are_not(runs):
    snapshot = runs[0]["base"][40]
    one, two = snapshot.restore(), snapshot.restore()
    a, b = one.current_map, two.current_map
    assert a.features(0) is b.features(0)
    for mine, theirs in zip(a.arrays, b.arrays, strict=True):
        assert not np.shares_memory(mine, theirs)


@pytest.mark.parametrize("at", [2, 40])
def test_dual_slam_continues_as_the_base_bit_for_bit(runs, sequence, at):
    images, stamps_s = sequence
    from_start, dual = runs[0]["base"][58].restore(), runs[0]["dual"][at].restore()
    before = fingerprint(dual)
    base = dual.as_base()
    assert type(base) is type(from_start)
    feed(base, images[at:58], stamps_s[at:58], check=False)
    assert fingerprint(base) == fingerprint(from_start)
    assert any(e.kind == "breakage" for e in base.events)
    assert fingerprint(dual) == before, "the base shares nothing that changes"


def test_after_a_breakage_dual_slam_cannot_become_the_base(runs):
    with pytest.raises(RuntimeError, match="differ from the first breakage on"):
        runs[0]["dual"][51].restore().as_base()
