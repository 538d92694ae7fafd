"""Lanes of a recording agree with the events and results."""

from dataclasses import replace

import numpy as np
from slam_fakes import CAMERA, fake_factory, make_sequence

from dslab.experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes, known_from
from dslab.experiments.recording import palette
from dslab.experiments.recording.describe import describe_event
from dslab.experiments.recording.lanes import Lane, segment_lanes, system_lanes
from dslab.experiments.recording.paths import RunPaths, pins, strips
from dslab.experiments.recording.placement import Placements
from dslab.experiments.recording.stories import stories
from dslab.experiments.runs.execution import RunRecord, execute
from dslab.slam.core import events as ev
from dslab.slam.core.results import MapTrajectory

BREAKS, NEW_MAP = 160, 180


def run(kind: str = "dual", **script) -> RunRecord:
    sequence = make_sequence()
    return execute(sequence, kind, 0, build=fake_factory(sequence, breaks_at=BREAKS, **script))


def recovered(record: RunRecord, first: int, last: int) -> RunRecord:
    """The run with additional final poses, as a recovery adds them."""
    main = record.trajectories[0]
    alike = np.linalg.inv(main.T_map_cam[0])
    frames = np.union1d(main.frames, np.arange(first, last + 1))
    truth = record.sequence.T_world_cam
    known = dict(zip(main.frames, main.T_map_cam, strict=True))
    poses = np.array([known.get(f, truth[f] @ alike) for f in frames])
    whole = MapTrajectory(main.map_id, frames, record.sequence.stamps_s[frames], poses)
    return replace(record, trajectories=(whole, *record.trajectories[1:]))


def with_events(record: RunRecord, *events: ev.Event) -> RunRecord:
    return replace(record, events=events)


def lane(record: RunRecord, name: str) -> Lane:
    (found,) = [x for x in system_lanes(record) if x.name == name]
    return found


def at(frame: int) -> dict:
    return {"frame": frame, "stamp_s": frame / CAMERA.fps, "map_id": 1}


def start(frame: int, thread: int) -> ev.RecoveryStart:
    return ev.RecoveryStart(**at(frame), thread=thread, method="orb", old_map_id=0, buffered_frames=9)


def end(frame: int, thread: int, success: bool, stage: str = "overlap") -> ev.RecoveryEnd:
    return ev.RecoveryEnd(
        **at(frame), thread=thread, method="orb", old_map_id=0, success=success,
        stage="" if success else stage, reason="", frames_covered=5, frames_passed_over=0, inliers=3,
        cpu_ms=1.0,
    )  # fmt: skip


def test_the_state_lane_follows_the_base():
    state = lane(run("base", relocalizes_after=50), "tracking")
    assert state.changes == [
        (0, "initialising"), (5, "tracking"), (BREAKS, "lost"), (BREAKS + 1, "relocalizing"),
        (BREAKS + 50, "tracking"),
    ]  # fmt: skip
    assert set(state.colors) == {value for _, value in state.changes}


def test_the_state_names_the_map_if_there_are_several():
    state = lane(run(recovers=False), "tracking")
    assert [value for _, value in state.changes] == [
        "initialising", "tracking, map 0", "initialising", "tracking, map 1",
    ]  # fmt: skip


def test_breakages_and_repairs_are_moments_in_lanes_that_do_not_tell_what_will_come():
    repaired, base = run(), run("base")
    assert lane(repaired, "breakages").changes == [(BREAKS, "broken"), (BREAKS + 1, "")]
    assert lane(repaired, "repairs").changes == [(NEW_MAP, "fused"), (NEW_MAP + 1, "")]
    assert lane(base, "breakages").changes == lane(repaired, "breakages").changes
    assert "repairs" not in [x.name for x in system_lanes(base)]


def test_a_cut_on_request_is_among_the_breakages_and_what_is_fused_mends_it():
    record = run()
    cut = with_events(record, ev.MapCut(**at(120)), *(e for e in record.events if e.kind == "fusion"))
    assert lane(cut, "breakages").changes == [(120, "cut"), (121, "")]
    assert lane(cut, "repairs").changes == [(NEW_MAP, "fused"), (NEW_MAP + 1, "")]
    assert FrameOutcome.RECOVERED in frame_outcomes(recovered(cut, BREAKS, NEW_MAP - 1))


def test_a_map_that_is_dropped_or_passed_by_is_not_broken_to_the_end():
    record = run(recovers=False)
    broke = replace(next(e for e in record.events if e.kind == "breakage"), frame=200, map_id=1)
    dropped = ev.MapDropped(**at(200), reason="broke_before_recovery", keyframes=2)
    again = ev.ReinitDone(**(at(210) | {"map_id": 2}), frames_taken=10)
    known = with_events(record, *record.events, broke, dropped, again)
    assert lane(known, "repairs").changes == [(210, "map dropped"), (211, "")]
    assert not stories(known)[1].is_repaired
    fused = replace(next(e for e in run().events if e.kind == "fusion"), frame=230, new_map_id=2)
    crossed = with_events(record, *known.events, fused)
    assert stories(crossed)[1].how == "bridged" and stories(crossed)[1].is_repaired


def test_a_breakage_is_told_only_as_far_as_it_is_known():
    (story,) = stories(run())
    assert story.label_at(NEW_MAP - 1) == "breakage 1"
    assert story.label_at(NEW_MAP) == "breakage 1: fused"


def test_silent_losses_have_a_lane():
    sequence = make_sequence()
    drifts = execute(sequence, "base", 0, build=fake_factory(sequence, drift_from=240))
    lost = lane(drifts, "silent_losses")
    assert 240 <= lost.changes[0][0] < 250 and "never declared" in lost.changes[0][1]
    assert "silent_losses" not in [x.name for x in system_lanes(run())]


def test_each_recovery_thread_has_a_lane_from_start_to_end():
    record = with_events(
        run(), start(170, 1), end(200, 1, False), start(200, 2), end(260, 2, True), start(290, 1)
    )
    assert lane(record, "recovery_thread_1").changes == [
        (170, "orb at work"), (200, "failed"), (201, ""), (290, "orb at work"),
    ]  # fmt: skip
    assert lane(record, "recovery_thread_2").changes == [
        (200, "orb at work"), (260, "succeeded"), (261, ""),
    ]  # fmt: skip
    assert not [x for x in system_lanes(run("base")) if x.name.startswith("recovery")]


def test_a_recovery_that_was_not_needed_any_more_has_not_failed():
    ended = end(200, 2, False, "cancelled")
    assert lane(with_events(run(), start(170, 2), ended), "recovery_thread_2").changes[1] == (
        200,
        "cancelled",
    )
    assert describe_event(ended) == ("recovery thread 2 (orb) cancelled: ", palette.PLAIN)


def test_a_recovery_within_one_frame_shows_its_outcome():
    record = with_events(run(), start(200, 1), end(200, 1, True))
    assert lane(record, "recovery_thread_1").changes == [(200, "succeeded"), (201, "")]


def test_frames_placed_by_initialization_are_not_recovered():
    assert frame_outcomes(recovered(run(), 2, 4))[:6] == [
        FrameOutcome.NONE,
        FrameOutcome.NONE,
        *[FrameOutcome.TRACKED] * 4,
    ]


def test_frames_of_a_dropped_map_have_no_pose():
    record = run(recovers=False)
    found = frame_outcomes(replace(record, trajectories=record.trajectories[:1]))
    assert found[100] is FrameOutcome.TRACKED and found[250] is FrameOutcome.NONE


def test_a_recovered_frame_is_known_from_the_fusion_onwards():
    record = recovered(run(), BREAKS, NEW_MAP - 1)
    assert known_from(record.events, 300)[[0, BREAKS, NEW_MAP, NEW_MAP + 1]].tolist() == [180, 180, 180, 300]
    paths = RunPaths(record, Placements(record, np.zeros(3)))
    assert paths.recovered_strips(NEW_MAP - 1) == [] and len(paths.lost_strips(NEW_MAP - 1)) == 1
    (green,) = paths.recovered_strips(NEW_MAP)
    assert 20 <= len(green) <= 21 and paths.lost_strips(NEW_MAP) == []


def test_positions_of_events_are_those_of_the_camera():
    record = run()
    found = RunPaths(record, Placements(record, np.zeros(3))).position(BREAKS)
    np.testing.assert_allclose(found, record.sequence.T_world_cam[BREAKS, :3, 3])


def test_labels_stand_beyond_the_path_and_those_close_to_each_other_apart():
    across, feet = (
        np.array([0.0, 1, 0]),
        [np.array([x, y, 0.0]) for x, y in ((0, 5), (1, 0), (2, 3), (50, 9))],
    )
    found = pins(feet, across, 9.0, 10.0)
    np.testing.assert_allclose([pin[0] for pin in found], feet)
    reach = [round(float(pin[1] @ across), 6) for pin in found]
    assert len(set(reach[:3])) == 3 and reach[3] == min(reach) > 9.0
    assert all(np.cross(pin[1] - pin[0], across).max() == 0 for pin in found)


def test_every_segment_has_a_lane_even_if_two_of_a_kind_overlap():
    record = run()
    (first,) = record.sequence.segments
    second = replace(
        first, start_s=5.5, end_s=6.5, first_frame=165, last_frame=299, runs=((165, 170), (299, 299))
    )
    none = replace(first, first_frame=-1, last_frame=-1)
    record = replace(record, sequence=replace(record.sequence, segments=(first, second, none)))
    assert [(x.name, x.changes) for x in segment_lanes(record)] == [
        ("low_texture_1", [(0, ""), (150, "low texture"), (181, "")]),
        (
            "low_texture_2",
            [(0, ""), (165, "low texture"), (171, ""), (299, "low texture")],
        ),
    ]


def test_a_path_is_cut_where_frames_are_missing_and_thinned():
    frames = np.array([0, 1, 2, 5, 6])
    cut = strips(frames, np.arange(15.0).reshape(5, 3))
    assert [len(np.unique(piece, axis=0)) for piece in cut] == [3, 2]
    long = strips(np.arange(5000), np.random.default_rng(0).normal(size=(5000, 3)))
    assert len(long) == 1 and len(long[0]) <= 602
    assert strips(np.empty(0, int), np.empty((0, 3))) == []
