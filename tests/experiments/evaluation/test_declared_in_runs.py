"""The real systems say what they assert; what a tampered part makes them assert falsely is found."""

from dataclasses import replace

import numpy as np
import pytest
from loop_scenes import ring
from slam_fakes import simulated_camera

from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.relation_audit import audit_asserted
from dslab.experiments.runs.execution import execute, system_factory
from dslab.sim.sequence import Sequence
from dslab.slam.core.frame import Frame
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.fusion import fuse
from dslab.slam.dual.recovery.registry import ThreadSpec
from dslab.slam.loop_closing.detection import LoopClosingConfig, LoopDetector
from dslab.slam.map.relation import loop_relation
from dslab.slam.runtime.backend import KeyframeTask
from dslab.slam.system import MonocularSlam
from dslab.slam.toy_sequence import CAMERA, toy_frames
from dslab.slam.tracking.probation import Probation

RECOVERY_ALONE = DualConfig(recovery_threads=(ThreadSpec("orb"),), relocalization=False, place_merging=None)
PLACE_ALONE = DualConfig(recovery_threads=(), relocalization=False)


@pytest.fixture(scope="module")
def sequence():
    images, stamps_s, poses = zip(*toy_frames(120, range(80, 86)), strict=True)
    return Sequence(
        name="toy",
        camera=simulated_camera(CAMERA),
        stamps_s=np.array(stamps_s),
        frames=images,
        T_world_cam=np.array(poses),
        depths=None,
        segments=(),
        meta={},
    )


def declared(sequence, kind="base", dual=None):
    return audit_declared(execute(sequence, kind, 0, build=system_factory(dual=dual)))


def shifted(S, share=0.3):
    """A similarity whose result stands aside by a share of the map's unit, its mean depth at the start."""
    aside = np.eye(4)
    aside[0, 3] = share
    return aside @ S


# -- loops ---------------------------------------------------------------------------------------------------


def judged_on_ring(**change):
    """Judge a loop of a ring whose end has drifted by a third in scale, from it or with a change."""
    r = ring()
    loop = replace(r.loop, **change)
    relation = loop_relation(r.map, loop.keyframe, loop.loop_keyframe, loop.S_cam_map)
    return audit_asserted(relation, truth_of(r))


def truth_of(r):
    """That of a ring's keyframes."""
    return Truth(np.arange(len(r.T_cam_world)) / 30, np.linalg.inv(r.T_cam_world))


def test_a_right_loop_after_heavy_drift_is_right_with_a_margin():
    drifted = ring()
    off = drifted.centres() - drifted.true_centres()
    assert np.linalg.norm(off, axis=1)[-6:].min() > 2  # metres, or there is no drift to survive
    found = judged_on_ring()
    assert found.false is False and found.reason == ""
    assert found.position_error_m < 0.5 * found.position_bound_m
    assert found.rotation_error_deg < 1 and abs(found.scale_error) < 0.03


def test_a_loop_to_another_place_or_at_another_scale_is_false():
    S = ring().loop.S_cam_map
    elsewhere = judged_on_ring(loop_keyframe=20, S_cam_map=ring().map.T_cam_map(20))
    assert elsewhere.false is True and elsewhere.position_error_m > 1
    small = S.copy()
    small[:3] *= 0.84
    assert judged_on_ring(S_cam_map=small).scale_error == pytest.approx(1 / 0.84 - 1, abs=0.04)
    assert judged_on_ring(S_cam_map=small).false is True


def test_the_two_sides_of_a_loop_share_no_keyframe():
    r = ring()
    relation = loop_relation(r.map, r.loop.keyframe, r.loop.loop_keyframe, r.loop.S_cam_map)
    assert relation.new.frames[0] == r.loop.keyframe and relation.old.frames[0] == r.loop.loop_keyframe
    assert not set(relation.new.frames) & set(relation.old.frames)
    assert 5 <= len(relation.old.frames) <= 40 and relation.depth > 0


class Tampered(LoopDetector):
    """Finds the true loop, and asserts it aside by a share of the map's unit."""

    def __init__(self, found, share):
        self.config = LoopClosingConfig(adjustment_iterations=1)
        self._found, self._share = found, share

    def detect(self, keyframe, rng):
        S = self._found.loop.S_cam_map @ np.linalg.inv(shifted(np.eye(4), self._share))
        return (replace(self._found.loop, S_cam_map=S), self._found.loop_points), []

    def closed(self, loop):
        pass


@pytest.mark.parametrize(("share", "false"), [(0.0, False), (0.8, True)])
def test_a_loop_that_a_tampered_detector_finds_is_judged_as_asserted_not_as_corrected(share, false):
    r = ring()
    system = MonocularSlam(CAMERA, 0)
    system.engine.store.add(r.map)
    system.engine.enter(0)
    last = Frame(r.map.features(r.loop.keyframe))
    system.tracker.start(last, r.loop.keyframe)
    task = KeyframeTask(last, system.mapper, Tampered(r, share), np.random.default_rng(0))
    system.engine.backend._close_loop(task, r.loop.keyframe)
    (event,) = [e for e in system.events if e.kind == "loop_closed"]
    found = audit_asserted(event.relation, truth_of(r))
    assert found.false is false


# -- relocalization ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_true_relocalization_is_right_and_a_displaced_one_false(sequence, monkeypatch):
    found = declared(sequence).relocalizations[0].audit
    assert found.false is False and found.frames_false == 0 and found.frames_judged > 20
    assert found.largest_error_m < 0.5 * found.position_bound_m
    real = Probation.offer

    def displaced(self, frame):
        outcome = real(self, frame)
        for tracked in self.frames if outcome.success else ():
            tracked.T_cam_map = shifted(tracked.T_cam_map)
        return outcome

    monkeypatch.setattr(Probation, "offer", displaced)
    audit = declared(sequence)
    assert audit.relocalizations[0].false is True
    assert audit.false_counts["false_relocalizations"] >= 1


# -- fusions and joins ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dual", "kind"), [(RECOVERY_ALONE, "fusions"), (PLACE_ALONE, "joins")])
@pytest.mark.slow
def test_a_true_fusion_is_right_and_a_displaced_one_false(sequence, monkeypatch, dual, kind):
    (found,) = getattr(declared(sequence, "dual", dual), kind)
    assert found.audit.false is False
    assert found.audit.position_error_m < 0.5 * found.audit.position_bound_m
    real = fuse.FusedMaps.of

    # Without points in common, by which the adjustment would take the new map back to its place.
    none = np.empty(0, np.int32)

    def displaced(old, new, alignments, *rest):
        aside = {"old_points": none, "new_points": none}
        return real(
            old, new, [replace(a, S_old_new=shifted(a.S_old_new), **aside) for a in alignments], *rest
        )

    monkeypatch.setattr(fuse.FusedMaps, "of", displaced)
    monkeypatch.setattr(fuse, "_fuse_seam", lambda *_: None)
    audit = declared(sequence, "dual", dual)
    assert getattr(audit, kind)[0].audit.false is True
    assert audit.false_counts[f"false_{kind}"] == 1


def test_what_is_asserted_stays_in_memory(sequence):
    record = execute(sequence, "base", 0, build=system_factory())
    (found,) = [e for e in record.events if e.kind == "relocalized"]
    assert found.relation is not None and "relation" not in found.record() and "relation" not in repr(found)
    assert list(found.record()) == [
        "event", "frame", "stamp_s", "map_id", "keyframe", "first_frame", "inliers", "frames_lost", "lost_s",
        "believed",
    ]  # fmt: skip
