"""Every broken invariant of direct odometry is reported."""

from dataclasses import replace

import numpy as np
import pytest

from dslab.slam.core.events import TrackingState
from dslab.slam.factory import build_system
from dslab.slam.invariants import InvariantError, check_result, check_system
from dslab.slam.toy_sequence import CAMERA, toy_frames

FRAMES, BLANK = 150, range(44, 114)


@pytest.fixture(scope="module")
def run():
    """A system with a closed map and one that goes on, found valid after every frame."""
    system = build_system("ldso", CAMERA, 3)
    check_system(system)
    for image, stamp_s, _ in toy_frames(FRAMES, BLANK, step_m=0.04):
        check_result(system.process(image, stamp_s))
        check_system(system)
    assert len(system.maps()) == 2 and system.state is TrackingState.TRACKING
    return system


def newest(system):
    return system._maps[system.current_map_id]


def keyframe_of_the_future(system):
    newest(system).keyframes[-1].frame = system.frames


def two_poses_of_a_keyframe(system):
    window = newest(system).window
    window.T_cam_map[window.newest, 0, 3] += 1


def pose_on_no_keyframe(system):
    frames = newest(system).frames
    last = max(frames)
    frames[last] = replace(frames[last], keyframe=len(newest(system).keyframes))


def pose_that_is_none(system):
    frames = newest(system).frames
    last = max(frames)
    frames[last] = replace(frames[last], T_cam_keyframe=2 * np.eye(4))


def point_of_a_keyframe_that_has_left(system):
    window = newest(system).window
    window.active.host[0] = np.flatnonzero(~window.live)[0]


def point_without_depth(system):
    newest(system).window.active.inverse_depth[0] = -1.0


def negative_variance(system):
    waiting = newest(system).window.immature
    waiting.variance[0] = -1.0


def brightness_of_nothing(system):
    newest(system).window.affine[0] = np.nan


def prior_of_a_keyframe_that_has_left(system):
    window = newest(system).window
    gone = 8 * int(np.flatnonzero(~window.live)[0])
    window.prior_H[gone, gone] = 1.0


def no_current_map(system):
    del system._maps[system.current_map_id]


def places_of_no_map(system):
    system._closers[9] = system._closers[system.current_map_id]


def open_map_of_the_past(system):
    system._maps[0].window = newest(system).window


BROKEN = [
    (keyframe_of_the_future, "a future frame"),
    (two_poses_of_a_keyframe, "two poses"),
    (pose_on_no_keyframe, "on no keyframe"),
    (pose_that_is_none, "the pose of a frame"),
    (point_of_a_keyframe_that_has_left, "has left"),
    (point_without_depth, "no depth"),
    (negative_variance, "is none"),
    (brightness_of_nothing, "affine of the window"),
    (prior_of_a_keyframe_that_has_left, "held by what was marginalised"),
    (no_current_map, "the current map"),
    (places_of_no_map, "does not exist"),
    (open_map_of_the_past, "map 0"),
]


@pytest.mark.parametrize(("break_it", "text"), BROKEN, ids=lambda v: getattr(v, "__name__", ""))
def test_a_broken_invariant_is_reported(run, break_it, text):
    system = run.snapshot().restore()
    check_system(system)
    break_it(system)
    with pytest.raises(InvariantError, match=text):
        check_system(system)
