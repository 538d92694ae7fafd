"""The audit judges what a loop, fusion or relocalization asserts, at its moment: false ones are found."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slam_fakes import circle, fake_factory, make_sequence

from dslab.experiments.eq1.judging import judge_run
from dslab.experiments.eq1.units import Exposure
from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.relation_audit import audit_asserted
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs.execution import execute
from dslab.slam.core import events as ev
from dslab.slam.core.relation import PlacedFrames, Relation

N = 600
STAMPS = np.arange(N) / 30
TRUTH = circle(N, turn=2.0)  # twice the same way: frame 300 + n is where frame n was
OLD, NEW = tuple(range(40, 0, -4)), tuple(range(340, 300, -4))
DEPTH_M = 2.0


def similarity(scale=1.0, shift_m=(0.0, 0.0, 0.0), turn_deg=0.0):
    S = np.eye(4)
    S[:3, :3] = scale * Rotation.from_rotvec([0, 0, turn_deg], degrees=True).as_matrix()
    S[:3, 3] = shift_m
    return S


MAP = similarity(0.4, (4, 5, 6), 30)  # the map is the world seen at .4 of its size


def placed(frames, S_error=None) -> PlacedFrames:
    """True poses of frames in the map's frame, displaced by an error."""
    frames = np.array(frames)
    T = (np.eye(4) if S_error is None else S_error) @ MAP @ TRUTH[frames]
    T[:, :3, :3] /= np.cbrt(np.linalg.det(T[:, :3, :3]))[:, None, None]
    return PlacedFrames(frames, STAMPS[frames], T)


def about(point: np.ndarray, S: np.ndarray) -> np.ndarray:
    """The similarity about a point instead of the origin."""
    out = S.copy()
    out[:3, 3] = S[:3, 3] + point - S[:3, :3] @ point
    return out


def asserted(scale=1.0, shift_m=(0.0, 0.0, 0.0), turn_deg=0.0, old=OLD, new=NEW):
    """A relation whose new side is off by this much, about the newest keyframe, metres."""
    centre = placed(new[:1]).T_map_cam[0, :3, 3]
    S_error = about(centre, similarity(scale, 0.4 * np.array(shift_m), turn_deg))
    return Relation(placed(old), placed(new, S_error), 0.4 * DEPTH_M)


def judged(*args, **kwargs):
    return audit_asserted(asserted(*args, **kwargs), Truth(STAMPS, TRUTH))


def test_a_true_relation_is_right_to_rounding():
    found = judged()
    assert found.false is False and found.reason == ""
    assert found.position_error_m < 1e-9 and found.rotation_error_deg < 1e-6 and abs(found.scale_error) < 1e-9


@pytest.mark.parametrize(
    ("error", "figure", "value"),
    [
        ({"scale": 0.84}, "scale_error", -0.16),
        ({"scale": 1.2}, "scale_error", 0.2),
        ({"shift_m": (0, 0.4, 0)}, "position_error_m", 0.4),
        ({"turn_deg": 8}, "rotation_error_deg", 8.0),
    ],
)
def test_a_wrong_scale_place_or_direction_is_false(error, figure, value):
    found = judged(**error)
    assert found.false is True and getattr(found, figure) == pytest.approx(value, abs=1e-3)


def test_small_errors_are_right_and_the_bound_is_that_of_the_place_not_of_the_way_between():
    found = judged(shift_m=(0, 0.1, 0), scale=1.03, turn_deg=1)
    assert found.false is False
    # The way from one side to the other is some 30 m; depth and window are 3 m.
    assert found.position_bound_m < 0.2


def test_a_relation_of_two_different_places_is_false():
    elsewhere = range(190, 150, -4)
    S = TRUTH[40] @ np.linalg.inv(TRUTH[190])  # as if it were the old place
    T = MAP @ S @ TRUTH[np.array(elsewhere)]
    T[:, :3, :3] /= 0.4
    new = PlacedFrames(np.array(elsewhere), STAMPS[np.array(elsewhere)], T)
    found = audit_asserted(Relation(placed(OLD), new, 0.8), Truth(STAMPS, TRUTH))
    assert found.false is True and found.position_error_m > 2


def test_drift_of_the_whole_map_does_not_make_a_right_relation_false():
    """The old side drifted to another size and place long ago: the relation is still right."""
    drift = similarity(2.5, (30, -20, 10), 70)
    relation = asserted()
    sides = []
    for side in (relation.old, relation.new):
        T = drift @ side.T_map_cam
        T[:, :3, :3] /= 2.5
        sides.append(PlacedFrames(side.frames, side.stamps_s, T))
    found = audit_asserted(Relation(*sides, 2.5 * relation.depth), Truth(STAMPS, TRUTH))
    assert found.false is False and found.position_error_m < 1e-9


def test_an_old_side_that_stands_still_leaves_it_open_and_more_keyframes_decide():
    still = (20, 19, 18, 19, 20)
    found = judged(old=still, shift_m=(0, 0.4, 0))
    assert found.false is None and "apart" in found.reason
    assert judged(old=(*still, 10, 5, 0), shift_m=(0, 0.4, 0)).false is True


def test_a_new_side_that_stands_still_is_judged_by_its_place_only():
    found = judged(new=(320, 319, 318, 319, 320), scale=1.5)
    assert found.scale_error is None and found.reason.startswith("scale")
    assert found.false is False
    assert judged(new=(320, 319, 318, 319, 320), shift_m=(1, 0, 0)).false is True


def test_an_old_side_that_is_corrupted_itself_leaves_it_open():
    relation = asserted()
    bent = relation.old.T_map_cam.copy()
    bent[5:, :3, 3] += 0.4 * np.array([0, 0, 2.0])
    old = PlacedFrames(relation.old.frames, relation.old.stamps_s, bent)
    found = audit_asserted(Relation(old, relation.new, relation.depth), Truth(STAMPS, TRUTH))
    assert found.false is None and "do not fit the truth themselves" in found.reason


# -- of a run ------------------------------------------------------------------------------------------------


def run_with(*planted, **script):
    """A run of the fake system that declares events on top of its own."""
    sequence = make_sequence()
    record = execute(sequence, "base", 0, build=fake_factory(sequence, **script))
    return type(record)(**{**vars(record), "events": (*record.events, *planted)})


def relation_in_run(shift_m: float) -> Relation:
    sequence, T = make_sequence(), circle(300)

    def side(frames, shift):
        poses = T[frames].copy()
        poses[:, 1, 3] += shift
        return PlacedFrames(frames, sequence.stamps_s[frames], poses)

    return Relation(side(np.arange(40, 0, -4), 0.0), side(np.arange(140, 100, -4), shift_m), 2.0)


def loop(shift_m):
    return ev.LoopClosed(
        frame=140, stamp_s=140 / 30, map_id=0, keyframe=140, loop_keyframe=40, scale=1.0, matches=50,
        cpu_ms=1.0, relation=relation_in_run(shift_m),
    )  # fmt: skip


def fusion(by, shift_m, accepted=True):
    return ev.Fusion(
        frame=140, stamp_s=140 / 30, map_id=0, old_map_id=0, new_map_id=1, by=by, accepted=accepted,
        scale=1.0, inliers=50, reason="", relation=relation_in_run(shift_m),
    )  # fmt: skip


def test_planted_false_loops_joins_and_fusions_are_counted_each_by_its_kind():
    planted = (
        *(loop(s) for s in (0.0, 0.7, 0.7, 0.7)),
        *(fusion("place", s) for s in (0.0, 0.7, 0.7)),
        *(fusion("recovery", s) for s in (0.0, 0.7)),
        fusion("recovery", 0.7, accepted=False),
    )
    audit = summarise(run_with(*planted))["audit"]
    assert [r["false"] for r in audit["loops"]] == [False, True, True, True]
    assert [r["false"] for r in audit["joins"]] == [False, True, True]
    assert [r["false"] for r in audit["fusions"]] == [False, True]
    assert (audit["false_loops"], audit["false_joins"], audit["false_fusions"]) == (3, 2, 1)
    assert audit["loops"][1]["position_error_m"] == pytest.approx(0.7)
    assert audit["loops"][1]["time_s"] == pytest.approx(140 / 30)


def test_false_declarations_are_counted_in_the_record_of_a_unit():
    silent = ev.LoopClosed(**{**vars(loop(0.0)), "relation": None})
    record = run_with(loop(0.7), loop(0.7), silent, fusion("place", 0.7))
    columns = judge_run(record, "dual", Exposure(5.0, 1.0, 150, 180, 195)).columns
    counts = {"dual_false_loops": 2, "dual_false_joins": 1, "dual_false_fusions": 0, "dual_unjudged": 1}
    assert {name: columns[name] for name in counts} == counts


def test_a_system_that_does_not_say_what_it_asserts_is_not_judged():
    silent = ev.LoopClosed(**{**vars(loop(0.7)), "relation": None})
    audit = audit_declared(run_with(silent))
    assert audit.loops[0].audit.false is None and audit.unjudged == 1
    assert audit.false_counts["false_loops"] == 0


def test_relocalized_frames_are_judged_one_by_one_for_a_second():
    right = audit_declared(run_with(breaks_at=160, relocalizes_after=40)).relocalizations[0].audit
    assert (right.frames_judged, right.frames_false, right.false) == (31, 0, False)
    off = (
        audit_declared(run_with(breaks_at=160, relocalizes_after=40, new_map_scale=1.5))
        .relocalizations[0]
        .audit
    )
    assert (off.frames_judged, off.frames_false, off.false) == (31, 31, True)
    assert off.largest_error_m > off.position_error_m > off.position_bound_m


def test_poses_that_leave_the_truth_later_are_counted_but_only_most_of_them_make_it_false():
    def found(drift_from):
        run = run_with(breaks_at=160, relocalizes_after=40, drift_from=drift_from)
        return audit_declared(run).relocalizations[0].audit

    late, soon = found(225), found(203)
    assert 0 < late.frames_false < 10 and late.false is False
    assert soon.frames_false > 20 and soon.false is True


def test_judging_ends_with_the_next_loss_and_where_a_correction_moves_the_map():
    again = ev.LoopClosed(**{**vars(loop(0.0)), "frame": 210, "stamp_s": 7.0})
    found = audit_declared(run_with(again, breaks_at=160, relocalizes_after=40)).relocalizations[0].audit
    assert found.frames_judged == 10
    record = run_with(breaks_at=160, relocalizes_after=40)
    lost = tuple(r if r.frame < 204 else type(r)(**{**vars(r), "state": ev.TrackingState.LOST})
                 for r in record.results)  # fmt: skip
    found = audit_declared(type(record)(**{**vars(record), "results": lost})).relocalizations[0].audit
    assert found.frames_judged == 4
