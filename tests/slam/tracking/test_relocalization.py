"""Relocalization of a system: on images, on probation, and after a mistake."""

from itertools import chain, repeat

import numpy as np
import pytest
from slam_scenes import (
    blanked,
    errors_m,
    feed,
    kinds,
    reconfigure,
    rms,
    toy,
)

from dslab.slam.core.events import Breakage, RelocalizationWithdrawn, Relocalized, TrackingState
from dslab.slam.factory import build_system
from dslab.slam.places.evidence import Support
from dslab.slam.places.recognition import KeyframeDatabase
from dslab.slam.toy_sequence import CAMERA
from dslab.slam.tracking.probation import ProbationConfig, Withdrawn
from dslab.slam.tracking.rules import own

STEP_M = 0.05


def rng():
    return np.random.default_rng(0)


# -- the system, on images -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def there_and_back():
    """The camera moves on, has blank frames, and is back at its place half a second before."""
    images, stamps_s, T_world_cam = toy(100, step_m=STEP_M)
    order = [*range(80), *range(80, 90), *range(60, 85)]
    shown = blanked([images[i] for i in order], range(80, 90))
    stamps_s = np.arange(len(order)) / CAMERA.fps
    return shown, stamps_s, T_world_cam[order]


@pytest.fixture(scope="module")
def recovered(there_and_back):
    """The base system, its results, and a snapshot just before the known place is in view again."""
    images, stamps_s, _ = there_and_back
    system = build_system("base", CAMERA, 0)
    results = [system.process(*each) for each in zip(images[:88], stamps_s[:88], strict=True)]
    snapshot = system.snapshot()
    return system, results + feed(system, images[88:], stamps_s[88:]), snapshot


def test_the_base_relocalizes_at_a_known_place(recovered, there_and_back):
    system, results, _ = recovered
    assert kinds(system)[:3] == ["initialized", "breakage", "relocalized"]
    _, broken, found = system.events[:3]
    assert isinstance(broken, Breakage) and isinstance(found, Relocalized)
    assert broken.frame == 80 and 90 <= found.first_frame <= 92
    assert found.frame == found.first_frame + ProbationConfig().frames
    assert found.frames_lost == found.frame - 80
    assert found.lost_s == pytest.approx(found.frames_lost / CAMERA.fps)
    assert found.map_id == 0 and found.inliers >= 50
    assert 40 <= found.keyframe < 80
    assert results[found.frame].inliers == found.inliers and results[found.frame].reason == ""
    assert all(r.state is TrackingState.TRACKING for r in results[found.frame :])
    (path,) = system.trajectories()
    assert set(range(found.first_frame, 115)) <= set(path.frames.tolist())
    errors, _ = errors_m(path, there_and_back[2])
    assert rms(errors) < 0.03 and errors.max() < 0.1


def test_the_view_of_the_loss_is_found_without_similar_keyframes(recovered, there_and_back, monkeypatch):
    monkeypatch.setattr(KeyframeDatabase, "relocalization_candidates", lambda *_: [])
    images = [*there_and_back[0][80:88], *there_and_back[0][110:115]]  # it broke just before this view
    system = recovered[2].restore()
    feed(system, images, np.arange(88, 101) / CAMERA.fps, check=False)
    assert kinds(system)[-1] == "relocalized"
    assert system.events[-1].keyframe == max(
        system.current_map.frame_index(int(k))
        for k in system.current_map.keyframes()
        if system.current_map.frame_index(int(k)) < 80
    )


def test_every_transition_has_its_reason_and_its_counts(recovered):
    system, results, _ = recovered
    found = system.events[2]
    assert results[80].state is TrackingState.LOST and results[80].reason == system.events[1].reason
    for r in results[81 : found.frame]:
        assert r.state is TrackingState.RELOCALIZING and r.T_map_cam is None
        assert r.reason and r.inliers <= r.matches and not r.inlier_mask.any()
        assert ("relocalize" in r.cpu_ms) is (r.frame <= found.first_frame)
        assert (r.reason == "on_probation") is (r.frame >= found.first_frame)
    # No relocalization while tracking.
    assert all("relocalize" not in r.cpu_ms for r in results[:81] + results[found.frame + 1 :])


def test_a_second_run_relocalizes_bit_for_bit(recovered, there_and_back):
    images, stamps_s, _ = there_and_back
    again = build_system("base", CAMERA, 0)
    results = feed(again, images[:94], stamps_s[:94], check=False)
    assert kinds(again)[-1] == "relocalized"
    for r, q in zip(recovered[1][:94], results, strict=True):
        assert (r.state, r.reason, r.inliers, r.matches) == (q.state, q.reason, q.inliers, q.matches)
        assert r.T_map_cam is None or r.T_map_cam.tobytes() == q.T_map_cam.tobytes()


def test_a_different_place_is_not_accepted(recovered, there_and_back):
    images = there_and_back[0]
    elsewhere, _, _ = toy(25, seed=5, step_m=STEP_M)
    system = recovered[2].restore()
    results = feed(system, elsewhere, np.arange(88, 113) / CAMERA.fps, check=False)
    assert kinds(system) == ["initialized", "breakage"]
    assert all(r.state is TrackingState.RELOCALIZING and r.reason for r in results)
    # At the known place it relocalizes, however long it was lost.
    reconfigure(system, probation=ProbationConfig(far_max_s=2.0))
    feed(system, images[10:80], 20.0 + np.arange(70) / CAMERA.fps, check=False)
    (found,) = [e for e in system.events if isinstance(e, Relocalized)]
    assert found.lost_s > 15 and found.stamp_s >= 22.0 - 1e-6


def test_a_relocalized_camera_needs_no_odds_as_behind_a_gap(recovered, there_and_back, monkeypatch):
    """Its probation says what they would."""
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    monkeypatch.setattr(own, "_BEHIND_A_GAP", np.inf)
    feed(system, images[88:98], stamps_s[88:98], check=False)
    assert kinds(system)[-1] == "relocalized"


# -- probation -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shown", "reason"),
    [
        (Support(100.0, 10, 1.0, 1.0, 0.0), "expected_points_missing"),
        (Support(100.0, 100, 1.0, 1.0, 0.9), "contradicted"),
        (Support(100.0, 100, 0.1, 1.0, 0.0), "too_narrow"),
    ],
)
def test_a_place_that_the_views_contradict_is_withdrawn_and_leaves_nothing(
    recovered, there_and_back, monkeypatch, shown, reason
):
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    monkeypatch.setattr("dslab.slam.tracking.probation.support", lambda *_, near: shown)
    before, path = system.current_map.copy(), system.trajectories()[0]
    results = feed(system, images[88:], stamps_s[88:], check=False)
    withdrawn = [e for e in system.events if isinstance(e, RelocalizationWithdrawn)]
    assert withdrawn and {e.reason for e in withdrawn} == {reason}
    assert all(e.frame - e.first_frame + 1 == e.frames for e in withdrawn)
    assert not any(isinstance(e, Relocalized) for e in system.events)
    assert all(r.T_map_cam is None for r in results)
    assert system.trajectories()[0].frames.tolist() == path.frames.tolist()
    for old, new in zip(before.arrays, system.current_map.arrays, strict=True):
        assert np.array_equal(old, new)


@pytest.mark.parametrize(
    ("expected", "reason"),
    [([58, 29, 10, 0], ""), ([58, 29, 10, 45], "too_narrow"), ([0, 10, 5, 0], "too_little_evidence")],
)
def test_frames_that_show_little_of_what_is_known_say_nothing(
    recovered, there_and_back, monkeypatch, expected, reason
):
    """The camera leaves what is known as soon as it has recognised it."""
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    shown = chain(expected, repeat(expected[-1]))

    def leaving(*_, near):
        n = next(shown)
        extent = 0.2 if n == 58 else 0.05
        return Support(float(n), round(0.8 * n), extent, 0.5, 0.0)

    monkeypatch.setattr("dslab.slam.tracking.probation.support", leaving)
    feed(system, images[88:], stamps_s[88:], check=False)
    assert kinds(system)[2] == ("relocalization_withdrawn" if reason else "relocalized")
    assert not reason or system.events[2].reason == reason


def test_a_place_is_known_by_what_was_seen_from_near_it(recovered, there_and_back, monkeypatch):
    """On recorded footage a right place shows .42 to .6 of all points, and .83 of those seen from near."""
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()

    def as_recorded(*_, near):
        return Support(100.0, 83 if near else 60, 20, 0.8, 0.1)

    monkeypatch.setattr("dslab.slam.tracking.probation.support", as_recorded)
    feed(system, images[88:98], stamps_s[88:98], check=False)
    assert kinds(system)[2] == "relocalized"


@pytest.mark.parametrize(("uncertain", "frames"), [(0, 4), (2, 2), (6, 1), (99, None)])
def test_a_frame_that_does_not_determine_its_pose_says_nothing_and_gets_none(
    recovered, there_and_back, monkeypatch, uncertain, frames
):
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    deviations = chain(repeat(np.deg2rad(1.0), uncertain), repeat(np.deg2rad(0.1)))
    monkeypatch.setattr("dslab.slam.tracking.probation.direction_deviation", lambda *_: next(deviations))
    feed(system, images[88:], stamps_s[88:], check=False)
    last = system.events[2]
    if frames is None:
        assert isinstance(last, RelocalizationWithdrawn) and last.reason == "too_little_evidence"
    else:
        assert isinstance(last, Relocalized) and last.frame - last.first_frame + 1 == frames
        posed = system.trajectories()[0].frames
        assert min(posed[posed > system.events[1].frame]) == last.first_frame


@pytest.mark.parametrize(("far_s", "far_share"), [(2.0, 1.0), (0.1, 0.2), (0.1, 0.5)])
def test_the_longer_the_camera_was_lost_the_longer_is_the_probation(
    recovered, there_and_back, far_s, far_share
):
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    reconfigure(system, probation=ProbationConfig(far_s=far_s, far_share=far_share))
    results = feed(system, images[88:], stamps_s[88:], check=False)
    found = next(e for e in system.events if isinstance(e, Relocalized))
    first_s = next(r.stamp_s for r in results if r.reason == "on_probation")  # it may not speak for the place
    lost_s = first_s - found.stamp_s + found.lost_s
    asked_s = max(0.1, far_share * lost_s) if lost_s > far_s else 0.1
    assert -1e-6 <= found.stamp_s - first_s - asked_s < 2 / 30


def test_the_poses_of_the_probation_count_once_it_is_confirmed(recovered):
    system, results, _ = recovered
    found = next(e for e in system.events if isinstance(e, Relocalized))
    assert all(results[f].T_map_cam is None for f in range(found.first_frame, found.frame))
    assert set(range(found.first_frame, found.frame + 1)) <= set(system.trajectories()[0].frames.tolist())


def test_dual_slam_relocalizes_in_its_saved_map_while_it_initializes(there_and_back):
    images, stamps_s, _ = (each[:96] for each in there_and_back)
    system = build_system("dual", CAMERA, 0)
    results = feed(system, images, stamps_s, check=False)
    (found,) = [e for e in system.events if isinstance(e, Relocalized)]
    assert kinds(system) == ["initialized", "breakage", "map_saved", "reinit_start", "relocalized"]
    assert (found.map_id, system.maps(), system.current_map_id) == (0, [0], 0)
    assert all(r.map_id == 0 and r.state is TrackingState.TRACKING for r in results[found.frame :])


def mistaken(system, stamps_s, faults, centre):
    """Plant a probation that was withdrawn at the last frame, with so many faulty frames."""
    seen = tuple((stamps_s[87] - 0.05 * n, "contradicted") for n in range(faults))
    system.engine.search._withdrawn = (Withdrawn(0, centre, stamps_s[87], seen, ()),)


FAR_AWAY = np.full(3, 1e3)


def test_a_place_after_a_mistaken_one_needs_more_frames(recovered, there_and_back):
    """Frames on an earlier, withdrawn probation count for some time."""
    images, stamps_s, _ = there_and_back
    first = {}
    for faults in (0, 6):
        system = recovered[2].restore()
        mistaken(system, stamps_s, faults, FAR_AWAY)
        feed(system, images[88:], stamps_s[88:], check=False)
        (found,) = [e for e in system.events if isinstance(e, Relocalized)]
        first[faults] = found.frame - found.first_frame
    assert first[0] == 3 and first[6] == 17  # 18 of 24 frames are three quarters


@pytest.mark.parametrize(("is_same", "frames"), [(True, 17), (False, 3)])
def test_a_place_that_goes_on_from_a_mistaken_one_inherits_what_spoke_against_it(
    recovered, there_and_back, is_same, frames
):
    """However long ago; another place has nothing to do with it."""
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    reconfigure(system, probation=ProbationConfig(memory_s=0.0))
    (path,) = recovered[0].trajectories()
    there = path.T_map_cam[path.frames > 87][0][:3, 3]
    mistaken(system, stamps_s, 6, there if is_same else FAR_AWAY)
    feed(system, images[88:], stamps_s[88:], check=False)
    (found,) = [e for e in system.events if isinstance(e, Relocalized)]
    assert found.frame - found.first_frame == frames


@pytest.mark.parametrize(("found", "reason"), [(120, ""), (200, "view_is_unknown")])
def test_a_view_that_no_keyframe_has_been_near_does_not_speak_for_a_far_place(
    recovered, there_and_back, monkeypatch, found, reason
):
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    reconfigure(system, probation=ProbationConfig(far_s=0.1, far_max_s=0.2))
    seen = Support(100.0, found, 20, 1.0, 0.0)
    monkeypatch.setattr("dslab.slam.tracking.probation.support", lambda *_, near: seen)
    feed(system, images[88:], stamps_s[88:], check=False)
    assert kinds(system)[2] == ("relocalization_withdrawn" if reason else "relocalized")
    assert not reason or system.events[2].reason == reason


def test_frames_that_say_nothing_do_not_confirm_a_far_place(recovered, there_and_back, monkeypatch):
    """The time that is asked begins with the first frame that shows something of what is known."""
    images, stamps_s, _ = there_and_back
    found = {}
    for silent in (0, 5):
        system = recovered[2].restore()
        reconfigure(system, probation=ProbationConfig(far_s=0.1, far_share=1e3, far_max_s=0.2))
        expected = iter([0.0] * silent)
        monkeypatch.setattr(
            "dslab.slam.tracking.probation.support",
            lambda *_, near, expected=expected: Support(next(expected, 100.0), 100, 20, 1.0, 0.0),
        )
        feed(system, images[88:], stamps_s[88:], check=False)
        (event,) = [e for e in system.events if isinstance(e, Relocalized)]
        found[silent] = event.frame
    assert found[5] == found[0] + 5
