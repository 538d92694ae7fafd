"""Self-doubt: a camera that wanders where the image shows nothing of it is not believed; others are."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import VIEW, blanked, check_maps, errors_m, feed, kinds, pose_error, rigid, rms, toy

from dslab.slam.config import SlamConfig
from dslab.slam.core.events import Breakage, PosesWithdrawn, Relocalized, TrackingState
from dslab.slam.core.frame import Features, Frame, FrameFeatures
from dslab.slam.factory import build_system
from dslab.slam.toy_sequence import CAMERA
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.doubt import Doubt, DoubtConfig, hidden_motion
from dslab.slam.tracking.rules import own

FPS = 15.0
STEP_M, DEPTH_M, PLANTED_AT = 0.06, 5.0, 70
EMPTY = (((2,), np.float32), ((), np.int32), ((), np.float32), ((), np.float32), ((4,), np.uint64))


def rng():
    return np.random.default_rng(0)


def orbit(degrees):
    """A motion of the camera round the point that it looks at."""
    centre = rigid((0, 0, DEPTH_M))
    return centre @ rigid(rotvec_deg=(0, degrees, 0)) @ np.linalg.inv(centre)


# -- hidden motion -------------------------------------------------------------------------------------------


@pytest.fixture
def wall():
    return rng().uniform((-1, -1, DEPTH_M), (1, 1, DEPTH_M), (200, 3))


def test_a_turn_that_takes_back_a_translation_hides_it(wall):
    alone, hidden = hidden_motion(wall, orbit(4.0), np.eye(4))
    assert alone == pytest.approx(np.deg2rad(4), rel=0.1)
    assert hidden == pytest.approx(alone, rel=0.25)


@pytest.mark.parametrize("T", [rigid((0.3, 0, 0)), rigid((0, 0, -0.3)), rigid(rotvec_deg=(0, 5, 2))])
def test_a_plain_translation_or_turn_hides_nothing(wall, T):
    assert hidden_motion(wall, T, np.eye(4))[1] < 0.005


# -- motions -------------------------------------------------------------------------------------------------


def posed(i, T_cam_map, direction=1):
    features = Features(*(np.zeros((0, *n), t) for n, t in EMPTY))
    frame = Frame(FrameFeatures.build(i, direction * i / FPS, features, CAMERA, VIEW))
    frame.T_cam_map = T_cam_map
    return frame


def doubted(wall, at, seconds=8.0, begin_turn=None, new_points=True, direction=1, **config):
    """Doubt of a camera that goes along a wall at 0.9 m/s, moved by ``at(i)`` in frame ``i``.

    Time runs in ``direction``, 1 or -1. From ``begin_turn`` on it is said to turn on the spot, 3 degrees a
    frame, before points ever nearer.
    """
    doubt, frames, x, yaw, depth = Doubt(DoubtConfig(**config)), [], 0.0, 0.0, 1.0
    for i in range(round(seconds * FPS)):
        if begin_turn is not None and i >= begin_turn:
            yaw, depth, x = yaw + 3.0, 0.95 * depth, x + 0.02 * STEP_M
        else:
            x += STEP_M
        T = rigid(rotvec_deg=(0, yaw, 0)) @ rigid((-x, 0, 0))
        frames.append(posed(i, at(i) @ T, direction))
        if i >= 2:
            seen = (wall * depth - T[:3, 3]) @ T[:3, :3] if yaw else wall + np.array([x, 0, 0])
            before, last = frames[-3].T_cam_map, frames[-2].T_cam_map
            predicted = last @ np.linalg.inv(before) @ last
            born = i - 2 if new_points else min(i, begin_turn or i) - 5
            doubt.note(frames[-1], frames[-2], predicted, seen, direction * born / FPS, deviation=0.0)
        if doubt.reason:
            break
    return doubt


def wander(begin, degrees=1.5):
    r = rng()
    return lambda i: orbit(r.normal(0, degrees)) if i >= begin else np.eye(4)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_camera_that_wanders_is_doubted_from_the_onset(wall, direction):
    doubt = doubted(wall, wander(PLANTED_AT), direction=direction)
    assert doubt.reason == "motion_beyond_prediction"
    assert PLANTED_AT <= doubt.first_frame <= PLANTED_AT + 3


def test_nothing_is_doubted_if_that_is_switched_off(wall):
    assert doubted(wall, wander(PLANTED_AT), min_share=0.0).reason == ""


def shaken(r):
    return rigid(rotvec_deg=r.normal(0, 3, 3))


def pushed(r):
    return rigid(r.normal(0, 0.1, 3))


def still(_):
    return np.eye(4)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_map_that_shrinks_is_doubted_from_the_onset(wall, direction):
    doubt = doubted(wall, still, begin_turn=PLANTED_AT, direction=direction)
    assert doubt.reason == "scale_of_new_points"
    assert doubt.first_frame == PLANTED_AT


def shrinking(wall, size, uncertain_deg, seconds=9.0, loop_at_s=None, **config):
    """Doubt where points and steps have the size ``size(s)``, ``s`` seconds behind five uncertain frames."""
    doubt, x, last, before = Doubt(DoubtConfig(**config)), 0.0, None, None
    for i in range(PLANTED_AT + round(seconds * FPS)):
        now = size((i - PLANTED_AT) / FPS) if i >= PLANTED_AT else 1.0
        if i == PLANTED_AT + round((loop_at_s or -1) * FPS):
            doubt.tie_scale()
        x += now * STEP_M
        frame = posed(i, rigid((-x, 0, 0)))
        if before is not None:
            predicted = last.T_cam_map @ np.linalg.inv(before.T_cam_map) @ last.T_cam_map
            deviation = np.deg2rad(uncertain_deg if PLANTED_AT - 5 <= i < PLANTED_AT else 0.03)
            doubt.note(frame, last, predicted, now * wall + (x, 0, 0), (i - 2) / FPS, deviation)
        before, last = last, frame
        if doubt.reason:
            break
    return doubt


@pytest.mark.parametrize("size", [lambda s: 1 / 3, lambda s: 0.88**s], ids=["at once", "step by step"])
def test_a_map_that_has_shrunk_since_the_direction_was_uncertain_is_doubted_from_there(wall, size):
    doubt = shrinking(wall, size, uncertain_deg=0.2)
    assert doubt.reason == "scale_of_new_points"
    assert doubt.first_frame == PLANTED_AT - 5


@pytest.mark.parametrize("settings", [
    {"uncertain_deg": 0.05}, {"uncertain_deg": 0.2, "shrunk": 4.0},
    {"uncertain_deg": 0.2, "uncertain_memory_s": 4.0}, {"uncertain_deg": 0.2, "loop_at_s": 2.0},
])  # fmt: skip
def test_a_slow_fall_is_believed(wall, settings):
    """Where the view held the camera, long after it did not, and once a loop has given the scale back."""
    assert shrinking(wall, lambda s: 0.88**s, **settings).reason == ""


def test_a_camera_that_stops_and_turns_to_something_near_is_believed(wall):
    assert doubted(wall, still, begin_turn=PLANTED_AT, new_points=False).reason == ""


def test_scale_is_not_doubted_if_that_is_switched_off(wall):
    assert doubted(wall, still, begin_turn=PLANTED_AT, nearer=0.0).reason == ""


@pytest.mark.parametrize("motion", [shaken, pushed])
def test_a_camera_that_is_really_shaken_is_believed(wall, motion):
    r = rng()
    assert doubted(wall, lambda i: motion(r) if i >= PLANTED_AT else np.eye(4)).reason == ""


def test_a_steady_orbit_is_believed(wall):
    assert doubted(wall, lambda i: orbit(max(0.0, 2.0 * (i - PLANTED_AT)))).reason == ""


def test_a_few_bad_frames_are_forgiven(wall):
    r = rng()
    brief = range(PLANTED_AT, PLANTED_AT + 3)
    assert doubted(wall, lambda i: orbit(r.normal(0, 2)) if i in brief else np.eye(4)).reason == ""


@pytest.mark.parametrize(("bad", "share", "since"), [(3, 0.5, 0), (0, 0.5, None), (3, 0.0, None)])
def test_the_last_frames_before_a_loss_are_not_forgiven(wall, bad, share, since):
    onset = PLANTED_AT - bad

    def turning(i):
        return orbit(4.0 * (i - onset + 1) ** 2) if i >= onset else np.eye(4)

    doubt = doubted(wall, turning, seconds=PLANTED_AT / FPS, min_share=share)
    assert doubt.reason == ""
    doubt.lose()
    assert doubt.first_frame == (-1 if since is None else onset + since)
    assert doubt.reason == ("" if since is None else "motion_beyond_prediction")


# -- in a system ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sequence():
    return toy(150)


@pytest.fixture
def wandering(monkeypatch):
    """From the planted frame on, tracking finds poses moved round the scene, to either side in turn."""

    def wrongly(find):
        def wrong(map_, frame, *rest, **also):
            found, index = find(map_, frame, *rest, **also), frame.features.index
            if PLANTED_AT <= index < PLANTED_AT + 30:
                frame.T_cam_map = orbit_in_map(map_, frame, 3.0 * (-1) ** index) @ frame.T_cam_map
            return found

        return wrong

    monkeypatch.setattr(own, "refine", wrongly(own.refine))


def orbit_in_map(map_, frame, degrees):
    points = map_.arrays.pt_xyz[frame.point[frame.point >= 0]]
    depth = np.median((points @ frame.T_cam_map[:3, :3].T + frame.T_cam_map[:3, 3])[:, 2])
    T = orbit(degrees)
    T[:3, 3] *= depth / DEPTH_M
    return T


def run(kind, sequence, min_share=0.5):
    tracking = TrackingConfig(doubt=replace(DoubtConfig(), min_share=min_share))
    system = build_system(kind, CAMERA, 0, SlamConfig(tracking=tracking))
    images, stamps_s, _ = sequence
    return system, feed(system, images, stamps_s)


def test_a_wandering_system_takes_its_poses_back(sequence, wandering):
    system, results = run("base", sequence)
    breakage = next(e for e in system.events if isinstance(e, Breakage))
    assert breakage.reason == "motion_beyond_prediction" and breakage.frame > PLANTED_AT
    withdrawn = system.events[system.events.index(breakage) + 1]
    assert isinstance(withdrawn, PosesWithdrawn) and withdrawn.reason == breakage.reason
    assert PLANTED_AT - 2 <= withdrawn.first_frame <= PLANTED_AT + 8
    assert withdrawn.last_frame == breakage.frame - 1
    assert withdrawn.frames == withdrawn.last_frame - withdrawn.first_frame + 1
    (path,) = system.trajectories()
    taken = range(withdrawn.first_frame, breakage.frame + 1)
    assert not np.isin(path.frames, taken).any()
    assert all(results[f].state is TrackingState.TRACKING for f in taken[:-1]), "what was said stays said"
    (keyframes,) = system.keyframe_trajectories()
    assert withdrawn.keyframes > 0 and not np.isin(keyframes.frames, taken).any()
    assert any(isinstance(e, Relocalized) for e in system.events)
    errors, _ = errors_m(path, sequence[2])
    assert rms(errors[path.frames < breakage.frame]) < 0.03


@pytest.mark.slow
def test_what_was_learned_just_before_a_loss_is_taken_back_if_it_was_unsteady(sequence, wandering):
    images, stamps_s, _ = sequence
    lost = range(PLANTED_AT + 4, PLANTED_AT + 9)
    system, _ = run("base", (blanked(images, lost), stamps_s, None))
    breakage, withdrawn = system.events[1:3]
    assert isinstance(breakage, Breakage) and breakage.frame == lost[0]
    assert breakage.reason == "too_few_matches_with_last_frame"
    assert isinstance(withdrawn, PosesWithdrawn) and withdrawn.reason == "motion_beyond_prediction"
    assert PLANTED_AT <= withdrawn.first_frame <= withdrawn.last_frame == lost[0] - 1


@pytest.mark.slow
def test_a_place_where_the_camera_still_wanders_is_not_recognised(sequence, wandering):
    system, _ = run("base", sequence)
    relocalized = next(e for e in system.events if isinstance(e, Relocalized))
    assert relocalized.first_frame >= PLANTED_AT + 28, "the wandering ends 30 frames after its begin"


@pytest.mark.slow
def test_without_doubt_the_wandering_is_not_noticed(sequence, wandering):
    system, _ = run("base", sequence, min_share=0.0)
    assert "poses_withdrawn" not in kinds(system)


@pytest.mark.slow
def test_dual_slam_recovers_from_a_doubted_map(sequence, wandering):
    system, _ = run("dual", sequence)
    assert {"poses_withdrawn", "map_saved"} <= set(kinds(system))


@pytest.mark.slow
def test_a_clean_sequence_is_never_doubted(sequence):
    system, _ = run("base", sequence)
    assert kinds(system) == ["initialized"]


# -- withdrawal ----------------------------------------------------------------------------------------------


def test_keyframes_since_a_frame_leave_the_map_and_the_others_stay_where_they_were(sequence):
    system = build_system("base", CAMERA, 0)
    images, stamps_s, _ = sequence
    fed = 110
    for image, stamp_s in zip(images[:fed], stamps_s, strict=False):
        system.process(image, float(stamp_s))
    before = {int(f): T for p in system.trajectories() for f, T in zip(p.frames, p.T_map_cam, strict=True)}
    system.tracker.doubt.reason, system.tracker.doubt.first_frame = "planted", 90
    result = system.process(images[fed], float(stamps_s[fed]))
    assert result.reason == "planted" and result.T_map_cam is None
    check_maps(system)
    (path,) = system.trajectories()
    assert path.frames.max() == 89
    (keyframes,) = system.keyframe_trajectories()
    assert keyframes.frames.max() < 90
    moved = [pose_error(before[int(f)], T) for f, T in zip(path.frames, path.T_map_cam, strict=True)]
    assert np.max(moved, axis=0)[0] < 0.05
