"""Loops are detected where a place is recognised by several keyframes, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from loop_scenes import ring

from dslab.slam.belief.config import BeliefConfig
from dslab.slam.loop_closing.correction import correct_loop
from dslab.slam.loop_closing.detection import LoopClosingConfig, LoopDetector
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.optimization.sim3 import horn_sim3, sim3_decompose


class Oracle:
    """Mock of place recognition that returns given candidates."""

    def __init__(self, candidates):
        self.candidates = candidates
        self.asked = []

    def loop_candidates(self, keyframe):
        self.asked.append(keyframe)
        return list(self.candidates.get(keyframe, []))


@pytest.fixture(scope="module")
def drifted():
    return ring(keyframes=60, overlap=6)


def same_place(r, keyframe):
    """The keyframe of the first round at the same place."""
    return keyframe - 60


def detector(r, candidates, **config):
    config = replace(LoopClosingConfig(), **config)
    return LoopDetector(r.map, Oracle(candidates), config, BeliefConfig())


def run(d, keyframes):
    """The loops found at keyframes, each closed at once."""
    found = {}
    for k in keyframes:
        found[k], _ = d.detect(k, np.random.default_rng(0))
        if found[k]:
            d.closed(found[k][0])
    return found


def test_the_third_consistent_keyframe_closes_the_loop(drifted):
    d = detector(drifted, {k: [same_place(drifted, k)] for k in range(60, 66)})
    found = run(d, range(60, 66))
    closed = [k for k, loop in found.items() if loop]
    assert closed == [62]
    loop, around = found[62]
    assert (loop.keyframe, loop.loop_keyframe) == (62, 2)
    # The similarity is that of the truth: the drift of sixty steps.
    s, _, _ = sim3_decompose(loop.S_cam_map)
    truth = drifted.T_cam_world[62] @ np.linalg.inv(drifted.T_cam_world[2])
    moved = loop.S_cam_map @ np.linalg.inv(drifted.map.T_cam_map(2))
    assert np.rad2deg(np.arccos((np.trace(moved[:3, :3] @ truth[:3, :3].T) / s - 1) / 2)) < 0.5
    assert s == pytest.approx(np.exp(0.006 * 60), rel=0.02)
    # Every match is of one point of the world.
    ids = np.concatenate(drifted.ids)
    shows = {int(p): int(ids[row]) for row, p in enumerate(drifted.map.arrays.kp_point[: len(ids)]) if p >= 0}
    assert len(loop.points) >= 40
    own = drifted.ids[62]
    assert np.mean([shows[int(p)] == own[row] for row, p in zip(loop.rows, loop.points, strict=True)]) > 0.98
    assert set(loop.points) <= set(around)


def test_the_detected_loop_closes_the_ring():
    r = ring(keyframes=60, overlap=6)
    d = detector(r, {k: [same_place(r, k)] for k in range(60, 66)})
    (loop, around) = run(d, range(60, 63))[62]
    before = _error(r)
    correct_loop(r.map, loop, around, LocalMappingConfig())
    check_map(r.map)
    assert _error(r) < before / 3


def _error(r):
    estimate, truth = r.centres(), r.true_centres()
    s, R, t = horn_sim3(truth, estimate)
    return np.sqrt(((s * estimate @ R.T + t - truth) ** 2).sum(1).mean())


def test_a_loop_is_asked_of_the_corrected_map_and_one_that_tears_it_is_not_corrected_again():
    r = ring(keyframes=60, overlap=6)
    d = detector(r, {k: [same_place(r, k)] for k in range(60, 66)})
    loop, _ = next(
        found for found, _ in (d.detect(k, np.random.default_rng(0)) for k in range(60, 66)) if found
    )
    corrected = r.map.copy()
    assert not loop.supposed.is_believed() and d.is_believed(loop, r.map, corrected) and loop.believed > 0.99
    corrected.arrays.kf_T_cam_map[20:40, 0, 3] += 1.0
    assert not d.is_believed(loop, r.map, corrected) and loop.believed < 0.9
    assert d.detect(loop.keyframe + 1, np.random.default_rng(0))[0] is None


def test_a_candidate_elsewhere_is_refused(drifted):
    d = detector(drifted, {k: [30] for k in range(60, 66)})
    assert not any(run(d, range(60, 66)).values())


def test_inconsistent_candidates_are_refused(drifted):
    """The right place, but never twice in a row."""
    d = detector(drifted, {60: [0], 61: [30], 62: [2], 63: [40], 64: [4]})
    assert not any(run(d, range(60, 65)).values())


def test_too_few_points_of_the_surroundings_are_refused(drifted):
    d = detector(drifted, {k: [same_place(drifted, k)] for k in range(60, 66)}, min_matches=100_000)
    assert not any(run(d, range(60, 66)).values())


def test_no_loop_is_detected_shortly_after_another(drifted):
    candidates = {k: [same_place(drifted, k)] for k in range(60, 66)}
    d = detector(drifted, candidates, consistency=1, min_gap=4)
    assert [k for k, loop in run(d, range(60, 66)).items() if loop] == [60, 64]


def test_a_culled_keyframe_is_skipped():
    r = ring(keyframes=60, overlap=6)
    d = detector(r, {k: [same_place(r, k)] for k in range(60, 66)}, consistency=1)
    r.map.cull_keyframe(63)
    assert d.detect(63, np.random.default_rng(0)) == (None, [])
    assert d._database.asked == []
