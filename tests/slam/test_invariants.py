"""Every broken invariant of a system is reported, and so are inconsistent events."""

from dataclasses import replace

import numpy as np
import pytest
from dual_scenes import CONFIG, RECOVERY_ONLY, STEP_M
from slam_scenes import blanked, feed, kinds, toy

from dslab.slam.core import events as ev
from dslab.slam.core.events import TrackingState
from dslab.slam.factory import build_system
from dslab.slam.invariants import InvariantError, check_events, check_result, check_system
from dslab.slam.toy_sequence import CAMERA


@pytest.fixture(scope="module")
def recovered():
    """A Dual-SLAM system after a breakage and a fusion, and its results."""
    images, stamps_s, _ = toy(100, 0, STEP_M)
    system = build_system("dual", CAMERA, 0, CONFIG, dual=RECOVERY_ONLY)
    results = feed(system, blanked(images, range(50, 56)), stamps_s, check=False)
    assert "fusion" in kinds(system)
    return system, results


@pytest.fixture
def system(recovered):
    """A copy of the system for each test."""
    return recovered[0].snapshot().restore()


@pytest.mark.parametrize(("kind", "frames"), [("base", 53), ("dual", 100)])
@pytest.mark.slow
def test_a_system_is_valid_at_any_time_and_the_check_changes_nothing(recovered, kind, frames):
    images, stamps_s, _ = toy(100, 0, STEP_M)
    system = build_system(kind, CAMERA, 0, CONFIG, dual=RECOVERY_ONLY)
    check_system(system)
    for image, stamp_s in list(zip(blanked(images, range(50, 56)), stamps_s, strict=True))[:frames]:
        check_result(system.process(image, float(stamp_s)))
        check_system(system)
    if kind == "dual":
        for checked, plain in zip(system.trajectories(), recovered[0].trajectories(), strict=True):
            assert checked.T_map_cam.tobytes() == plain.T_map_cam.tobytes()


def poses(system):
    return system.engine.store.poses._poses[system.current_map_id]


def map_broken(system):
    system.current_map.arrays.pt_observations[:] += 1


def two_roots(system):
    system.current_map.set_parent(1, -1)


def keyframe_of_a_future_frame(system):
    m = system.current_map
    m._features[0] = replace(m._features[0], index=system.frames)


def no_poses(system):
    poses(system).clear()


def pose_of_a_future_frame(system):
    poses(system)[system.frames] = poses(system)[10]


def pose_on_an_unknown_keyframe(system):
    poses(system)[10] = replace(poses(system)[10], keyframe=system.current_map.n_keyframes)


def pose_not_finite(system):
    poses(system)[10] = replace(poses(system)[10], T_cam_keyframe=np.full((4, 4), np.nan))


def poses_out_of_order(system):
    poses(system)[10] = replace(poses(system)[10], stamp_s=poses(system)[20].stamp_s)


def sought_under_a_taken_number(system):
    system.engine.state = TrackingState.NOT_INITIALIZED


def current_map_gone(system):
    system.engine.store.current_id = 7


def tracker_elsewhere(system):
    system.tracker.map = system.current_map.copy()


def mapper_elsewhere(system):
    system.mapper.map = system.current_map.copy()


def young_point_unknown(system):
    system.mapper._young = np.array([system.current_map.n_points])


def velocity_not_finite(system):
    system.tracker.velocity = np.full((4, 4), np.nan)


def no_last_frame(system):
    system.tracker.last = None


def last_on_no_keyframe(system):
    system.tracker.last.reference_keyframe = system.current_map.n_keyframes


def last_matches_no_point(system):
    system.tracker.last.point[0] = system.current_map.n_points


def map_misnumbered(system):
    system.current_map.map_id = 9


def poses_of_no_map(system):
    system.engine.store.poses._poses[9] = dict(poses(system))


def places_of_no_map(system):
    system.engine.store._places[9] = system.engine.store.places(system.current_map_id)


def places_of_another_map(system):
    system.engine.store.places(system.current_map_id).relocalizer.map = system.current_map.copy()


def saved_twice(system):
    system.engine.store.saved = [system.current_map_id] * 2


def saved_map_gone(system):
    system.engine.store.saved = [9]


def current_map_saved(system):
    system.engine.store.saved = [system.current_map_id]


def buffer_out_of_order(system):
    frames = system.buffer._frames
    frames[0], frames[1] = frames[1], frames[0]


def buffer_against_time(system):
    frames = system.buffer._frames
    frames[0] = replace(frames[0], stamp_s=frames[1].stamp_s)


def buffer_behind(system):
    system.buffer._frames.pop()


def buffer_too_long(system):
    frames = system.buffer._frames
    frames[0] = replace(frames[0], stamp_s=-1000.0)


def event_of_a_future_frame(system):
    system.events[-1] = replace(system.events[-1], frame=system.frames, stamp_s=1000.0)


def map_without_beginning(system):
    m = system.current_map.copy(9)
    system.engine.store._maps[9] = m
    system.engine.store.poses._poses[9] = dict(poses(system))


BROKEN = {
    map_broken: "map 0: observation counts disagree",
    two_roots: "map 0: the spanning tree has 2 roots",
    keyframe_of_a_future_frame: "a keyframe of a future frame",
    no_poses: "no frame has a pose",
    pose_of_a_future_frame: "a pose of a future frame",
    pose_on_an_unknown_keyframe: "a pose on a keyframe that does not exist",
    pose_not_finite: "the pose of a frame is not finite",
    poses_out_of_order: "poses run against time",
    sought_under_a_taken_number: "the new map has the id of an existing one",
    current_map_gone: "the current map does not exist",
    tracker_elsewhere: "the tracker works in another map",
    mapper_elsewhere: "the mapper works in another map",
    young_point_unknown: "the mapper watches a point that does not exist",
    velocity_not_finite: "velocity is not finite",
    no_last_frame: "no last frame",
    last_on_no_keyframe: "the last frame has no reference keyframe",
    last_matches_no_point: "the last frame matches no point",
    map_misnumbered: "map 0 has another number",
    poses_of_no_map: "poses of a map that does not exist",
    places_of_no_map: "places of map 9, which does not exist",
    places_of_another_map: "places of map 0 are those of another one",
    saved_twice: "a map is saved twice",
    saved_map_gone: "a saved map does not exist",
    current_map_saved: "the current map is a saved one",
    buffer_out_of_order: "the buffer is out of order",
    buffer_against_time: "the buffer runs against time",
    buffer_behind: "the buffer lacks the newest frame",
    buffer_too_long: "the buffer has outgrown its cap",
    event_of_a_future_frame: "an event of a future frame",
    map_without_beginning: "2 maps initialized, 0 dropped, 1 fused: 2 left",
}


@pytest.mark.parametrize("corrupt", BROKEN, ids=lambda corrupt: corrupt.__name__)
def test_a_broken_invariant_is_named(system, corrupt):
    corrupt(system)
    with pytest.raises(InvariantError, match=BROKEN[corrupt]):
        check_system(system)


def test_a_broken_result_is_refused(recovered):
    _, results = recovered
    tracked, lost = results[-1], next(r for r in results if r.frame == 50)
    for wrong, why in (
        (replace(tracked, T_map_cam=None), "and pose disagree"),
        (replace(lost, T_map_cam=np.eye(4)), "and pose disagree"),
        (replace(tracked, T_map_cam=np.full((4, 4), np.nan)), "not finite"),
        (replace(tracked, T_map_cam=2 * np.eye(4)), "no rotation"),
        (replace(tracked, reason="bored"), "with a reason of failure"),
        (replace(tracked, inlier_mask=tracked.inlier_mask[1:]), "keypoints and mask disagree"),
    ):
        with pytest.raises(InvariantError, match=why):
            check_result(wrong)


# -- events ----------------------------------------------------------------------------------------------


@pytest.fixture
def run_events(recovered):
    """The events of the run by kind; each kind occurs once, except ``initialized``."""
    events = list(recovered[0].events)
    check_events(events)
    return events


def place(run_events, kind):
    return next(i for i, e in enumerate(run_events) if e.kind == kind)


def test_a_recovery_ends_once_and_only_if_started(run_events):
    start, end = place(run_events, "recovery_start"), place(run_events, "recovery_end")
    with pytest.raises(InvariantError, match=r"recovery_end at frame .*: the recovery does not"):
        check_events(run_events[:start] + run_events[start + 1 :])
    with pytest.raises(InvariantError, match="the recovery does not"):
        check_events([*run_events[: end + 1], run_events[end]])
    with pytest.raises(InvariantError, match="the recovery runs"):
        check_events([*run_events[: start + 1], run_events[start]])


@pytest.mark.parametrize("kind", ["breakage", "map_saved", "recovery_start", "reinit_done"])
def test_an_event_is_of_a_map_that_exists(run_events, kind):
    at = place(run_events, kind)
    with pytest.raises(InvariantError, match=f"{kind} at frame"):
        check_events([*run_events[:at], replace(run_events[at], map_id=9)])


@pytest.mark.parametrize("kind", ["recovery_start", "recovery_end", "fusion"])
def test_recovery_and_fusion_have_an_existing_old_map(run_events, kind):
    at = place(run_events, kind)
    with pytest.raises(InvariantError, match=f"{kind} at frame .*: old map 9 does not exist"):
        check_events([*run_events[:at], replace(run_events[at], old_map_id=9)])


def test_a_map_is_initialized_once(run_events):
    with pytest.raises(InvariantError, match="map 0 exists already"):
        check_events([run_events[0], run_events[0]])


def test_a_dropped_map_does_not_exist(run_events):
    at = place(run_events, "breakage")
    breakage = run_events[at]
    dropped = ev.MapDropped(
        frame=breakage.frame, stamp_s=breakage.stamp_s, map_id=0, reason="synthetic", keyframes=3
    )
    with pytest.raises(InvariantError, match=r"map_dropped at frame .*: map 0 does not exist"):
        check_events([*run_events[: at + 1], dropped, dropped])


def test_a_relocalization_may_be_withdrawn_after_its_map_was_joined(run_events):
    at = place(run_events, "fusion")
    fusion = run_events[at]
    withdrawn = ev.RelocalizationWithdrawn(
        frame=fusion.frame, stamp_s=fusion.stamp_s, map_id=fusion.new_map_id, keyframe=3,
        first_frame=fusion.frame, frames=1, reason="maps_are_joined",
    )  # fmt: skip
    check_events([*run_events[: at + 1], withdrawn])
    with pytest.raises(InvariantError, match=r"relocalization_withdrawn at frame .*: map 9 did not exist"):
        check_events([*run_events[: at + 1], replace(withdrawn, map_id=9)])


def test_a_new_map_needs_a_reinitialization(run_events):
    at = place(run_events, "reinit_done")
    with pytest.raises(InvariantError, match="no reinitialization was started"):
        check_events([*run_events[: at + 1], run_events[at]])


def test_events_are_in_order_of_time(run_events):
    breakage = run_events[place(run_events, "breakage")]
    later = replace(breakage, frame=run_events[-1].frame + 1)
    with pytest.raises(InvariantError, match="events run against time"):
        check_events([*run_events, replace(later, stamp_s=0.0)])
    with pytest.raises(InvariantError, match="has another time"):
        check_events([*run_events, replace(run_events[-1], stamp_s=0.0)])
    with pytest.raises(InvariantError, match="comes after one of frame"):
        check_events([run_events[0], replace(breakage, frame=60, stamp_s=2.0), breakage])
    at = {"frame": 60, "stamp_s": 2.0, "map_id": 0}
    refused = ev.LoopRefused(**at, keyframe=60, loop_keyframe=3, matches=40, reason="contradicted")
    refined = ev.CameraRefined(
        **at,
        **dict.fromkeys(("k1", "k2", "p1", "p2", "readout_s", "shift_px", "significance"), 0.0),
        keyframes=21,
        cpu_ms=1.0,
    )
    later = replace(breakage, frame=63, stamp_s=2.1)
    check_events([run_events[0], later, refused, refined])  # the end of what a keyframe has started
    with pytest.raises(InvariantError, match="is at no frame"):
        check_events([replace(run_events[0], frame=-1)])


def test_the_scale_of_a_fusion_is_positive(run_events):
    at = place(run_events, "fusion")
    with pytest.raises(InvariantError, match="scale -1"):
        check_events([*run_events[:at], replace(run_events[at], scale=-1.0)])
