"""The audit finds true losses, late declarations and false fusions, and only those."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slam_fakes import circle, fake_factory, make_sequence

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit import AuditBounds, audit_loss, audit_relation
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs.execution import execute
from dslab.slam.core.results import MapTrajectory

N = 300
STAMPS = np.arange(N) / 30


def live(frames, shift_from: int | None = None, turn: bool = False) -> MapTrajectory:
    """The true circle as an estimate, displaced by a metre (or half a turn) from a frame on."""
    T = circle(N)
    if shift_from is not None:
        if turn:
            T[shift_from:, :3, :2] *= -1
        else:
            T[shift_from:, :3, 3] += [0.0, 0.0, 1.0]
    frames = np.asarray(frames)
    return MapTrajectory(0, frames, STAMPS[frames], T[frames])


def test_a_sound_map_shows_no_loss():
    found = audit_loss(live(range(N)), Truth(STAMPS, circle(N)), 150, 200)
    assert found.true_loss_frame is None


@pytest.mark.parametrize("turn", [False, True])
def test_the_loss_is_the_first_frame_that_stays_off(turn):
    found = audit_loss(live(range(N), shift_from=170, turn=turn), Truth(STAMPS, circle(N)), 150, 200)
    assert found.true_loss_frame == 170


def test_frames_without_a_pose_are_lost():
    found = audit_loss(live(range(165)), Truth(STAMPS, circle(N)), 150, 200)
    assert found.true_loss_frame == 165


def test_a_gap_that_heals_is_no_loss():
    frames = [*range(160), *range(170, N)]
    assert audit_loss(live(frames), Truth(STAMPS, circle(N)), 150, 200).true_loss_frame is None


def test_an_error_within_the_bounds_is_no_loss():
    T = circle(N)
    T[170:, 2, 3] += 0.09
    found = audit_loss(MapTrajectory(0, np.arange(N), STAMPS, T), Truth(STAMPS, circle(N)), 150, 200)
    assert found.true_loss_frame is None
    tight = AuditBounds(position_share=0.0, position_floor_m=0.08)
    found = audit_loss(MapTrajectory(0, np.arange(N), STAMPS, T), Truth(STAMPS, circle(N)), 150, 200, tight)
    assert found.true_loss_frame == 170


def test_a_truth_of_fewer_frames_than_the_camera_hides_no_loss():
    truth = circle(N)
    truth[1::2] = np.nan
    assert audit_loss(live(range(N), shift_from=170), Truth(STAMPS, truth), 150, 200).true_loss_frame == 170


def test_too_short_a_lead_in_cannot_be_judged():
    assert isinstance(audit_loss(live(range(145, N)), Truth(STAMPS, circle(N)), 150, 200), Undefined)


def fused(path):
    """Judge both sides of a breakage in one map."""
    return audit_relation(path, path, STAMPS, circle(N), 150, AuditBounds())


@pytest.mark.parametrize(("factor", "false"), [(1.0, False), (1.05, False), (1.3, True), (0.7, True)])
def test_a_wrong_scale_after_a_fusion_is_found(factor, false):
    T = circle(N)
    seam = T[150, :3, 3].copy()
    T[151:, :3, 3] = seam + factor * (T[151:, :3, 3] - seam)
    found = fused(MapTrajectory(0, np.arange(N), STAMPS, T))
    assert found.scale_error == pytest.approx(factor - 1, abs=1e-6)
    assert found.false is false


def test_a_displaced_part_after_a_fusion_is_false_though_its_scale_is_right():
    T = circle(N)
    T[151:, :3, 3] += [0.5, 0.5, 0.5]
    found = fused(MapTrajectory(0, np.arange(N), STAMPS, T))
    assert found.scale_error == pytest.approx(0, abs=1e-9)
    assert found.seam_error_m == pytest.approx(np.sqrt(0.75))
    assert found.false is True


def test_a_fusion_with_nothing_after_it_is_not_judged():
    found = fused(live(range(151)))
    assert found.false is None
    assert "no pose after" in found.reason and "scale" in found.reason


def test_the_audit_of_a_run_gives_the_delay_of_a_late_declaration():
    sequence = make_sequence()
    record = execute(sequence, "base", 0, build=fake_factory(sequence, breaks_at=172, drift_from=160))
    (loss,) = summarise(record)["audit"]["losses"]
    # The drift of the fake, 0.1 m per frame, leaves the bound within a few frames.
    assert 160 < loss["true_loss_frame"] <= 164
    assert loss["declared_frame"] == 172
    assert loss["delay_s"] == pytest.approx((172 - loss["true_loss_frame"]) / 30)
    assert loss["silent"] is False


def test_the_audit_of_a_run_finds_a_silent_loss():
    sequence = make_sequence()
    record = execute(sequence, "base", 0, build=fake_factory(sequence, drift_from=160))
    (loss,) = summarise(record)["audit"]["losses"]
    assert loss["silent"] is True and loss["declared_frame"] is None


@pytest.mark.parametrize(("scale", "false"), [(1.0, False), (1.5, True)])
def test_the_audit_of_a_run_judges_a_relocalization(scale, false):
    sequence = make_sequence()
    build = fake_factory(sequence, breaks_at=160, relocalizes_after=40, new_map_scale=scale)
    summary = summarise(execute(sequence, "base", 0, build=build))
    (found,) = summary["audit"]["relocalizations"]
    assert (found["frame"], found["map_id"], found["false"]) == (200, 0, false)
    assert summary["audit"]["false_relocalizations"] == int(false)
    assert summary["audit"]["fusions"] == []
    assert (summary["relocalizations"], summary["recoveries"]) == (1, 0)
    (breakage,) = summary["breakage_list"]
    assert breakage["relocalized_frame"] == 200 and breakage["lost_s"] == pytest.approx(40 / 30)
    (segment,) = summary["segments"]
    assert segment["relocalizations"] == 1


def test_a_breakage_outside_the_segments_is_audited_too():
    sequence = make_sequence()
    record = execute(sequence, "base", 0, build=fake_factory(sequence, breaks_at=250))
    losses = summarise(record)["audit"]["losses"]
    assert [x["segment"] for x in losses] == [0, None]
    assert losses[1]["declared_frame"] == losses[1]["true_loss_frame"] == 250


# -- the relation of two maps --------------------------------------------------------------------------------

ONSET, BEGUN = 120, 150


def similarity(scale=1.0, shift_m=(0.0, 0.0, 0.0), turn_deg=0.0):
    S = np.eye(4)
    S[:3, :3] = scale * Rotation.from_rotvec([0, 0, turn_deg], degrees=True).as_matrix()
    S[:3, 3] = shift_m
    return S


def related(S_error: np.ndarray, new_frames=range(BEGUN, BEGUN + 12)):
    """Audit an old map at half size and a new one placed in it with a known error."""
    S_old_world = similarity(0.5, (1, 2, 3), 30)
    T = circle(N)

    def seen(frames, S):
        frames = np.asarray(frames)
        return MapTrajectory(0, frames, STAMPS[frames], moved(T[frames], S))

    old, placed = seen(range(5, ONSET + 10), S_old_world), seen(new_frames, S_error @ S_old_world)
    return audit_relation(old, placed, STAMPS, T, ONSET)


def moved(T, S):
    scale = np.cbrt(np.linalg.det(S[:3, :3]))
    out = S @ T
    out[:, :3, :3] /= scale
    return out


def test_the_true_relation_of_two_maps_is_sound():
    found = related(np.eye(4))
    assert found.false is False and found.reason == ""
    assert abs(found.scale_error) < 1e-9 and found.seam_error_m < 1e-9


@pytest.mark.parametrize("scale", [0.8, 1.2])
def test_a_relation_of_wrong_scale_is_false(scale):
    found = related(similarity(scale))
    assert found.false is True
    assert found.scale_error == pytest.approx(scale - 1, abs=1e-6)


def test_a_relation_to_the_wrong_place_is_false():
    found = related(similarity(shift_m=(0.5, 0, 0)))
    assert found.false is True and abs(found.scale_error) < 1e-6
    assert found.seam_error_m == pytest.approx(1.0, abs=1e-6)  # the old map is at half size
    turned = related(similarity(turn_deg=8))
    assert turned.false is True and turned.seam_rotation_deg == pytest.approx(8, abs=0.1)


def test_a_new_map_with_few_frames_is_judged_only_by_its_position():
    found = related(similarity(1.2), new_frames=range(BEGUN, BEGUN + 3))
    assert found.scale_error is None and found.seam_error_m is not None and "scale" in found.reason
