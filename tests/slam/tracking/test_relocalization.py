"""Relocalization of a system: on images, on probation, and after a mistake."""

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

from dslab.slam.belief.belief import DISBELIEVED
from dslab.slam.belief.config import BeliefConfig
from dslab.slam.belief.model import come, prior
from dslab.slam.belief.sight import sight_of
from dslab.slam.core.events import Breakage, RelocalizationWithdrawn, Relocalized, TrackingState
from dslab.slam.factory import build_system
from dslab.slam.places.recognition import KeyframeDatabase
from dslab.slam.toy_sequence import CAMERA
from dslab.slam.tracking.probation import Withdrawn
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
    assert found.first_frame <= found.frame <= found.first_frame + 2
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
    reconfigure(system, belief=BeliefConfig(alpha=0.05))
    feed(system, images[10:80], 20.0 + np.arange(70) / CAMERA.fps, check=False)
    (found,) = [e for e in system.events if isinstance(e, Relocalized)]
    assert found.lost_s > 15 and found.stamp_s < 22.3


def test_a_relocalized_camera_needs_no_odds_as_behind_a_gap(recovered, there_and_back, monkeypatch):
    """Its probation says what they would."""
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    monkeypatch.setattr(own, "_BEHIND_A_GAP", np.inf)
    feed(system, images[88:98], stamps_s[88:98], check=False)
    assert kinds(system)[-1] == "relocalized"


# -- probation -----------------------------------------------------------------------------------------------


def shows(monkeypatch, of_view):
    """Let each view on probation show what a function of its number says: a share of its points, or None."""
    numbers = iter(range(1000))

    def told(*arguments):
        sight, share = sight_of(*arguments), of_view(next(numbers))
        if share is None:
            return sight._replace(**{name: getattr(sight, name)[:0] for name in sight._fields})
        gone = sight.cell % 10 >= 10 * share
        return sight._replace(shown=np.where(gone, 0.0, sight.shown))

    monkeypatch.setattr("dslab.slam.tracking.probation.sight_of", told)


def test_a_place_that_the_views_contradict_is_withdrawn_and_leaves_nothing(
    recovered, there_and_back, monkeypatch
):
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    reconfigure(system, belief=BeliefConfig(patience_s=0.2))
    shows(monkeypatch, lambda _: 0.3)
    before, path = system.current_map.copy(), system.trajectories()[0]
    results = feed(system, images[88:], stamps_s[88:] + 20.0, check=False)
    withdrawn = [e for e in system.events if isinstance(e, RelocalizationWithdrawn)]
    assert withdrawn and {e.reason for e in withdrawn} == {DISBELIEVED}
    assert all(e.frame - e.first_frame + 1 == e.frames for e in withdrawn)
    assert not any(isinstance(e, Relocalized) for e in system.events)
    assert all(r.T_map_cam is None for r in results)
    assert system.trajectories()[0].frames.tolist() == path.frames.tolist()
    for old, new in zip(before.arrays, system.current_map.arrays, strict=True):
        assert np.array_equal(old, new)


def first_confirmed(recovered, there_and_back, withdrawn=(), **settings):
    """Frames from the first relocalized one to the one that confirms it."""
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    reconfigure(system, belief=BeliefConfig(**settings))
    system.engine.search._withdrawn = withdrawn
    feed(system, images[88:], stamps_s[88:], check=False)
    found = [e for e in system.events if isinstance(e, Relocalized)]
    return (found[0].frame - found[0].first_frame, system) if found else (np.inf, system)


def test_views_that_should_show_nothing_confirm_nothing_and_are_not_held_against_a_place(
    recovered, there_and_back, monkeypatch
):
    shows(monkeypatch, lambda n: None if n < 4 else 1.0)
    assert first_confirmed(recovered, there_and_back)[0] == 0  # poses count from the first that speaks
    shows(monkeypatch, lambda n: None)
    assert first_confirmed(recovered, there_and_back)[0] == np.inf


def test_poses_count_from_the_first_view_that_speaks_for_the_place(recovered, there_and_back, monkeypatch):
    shows(monkeypatch, lambda n: 0.3 if n < 3 else 1.0)
    frames, system = first_confirmed(recovered, there_and_back)
    tried = next(r for r in system.events if isinstance(r, Relocalized))
    posed = system.trajectories()[0].frames
    assert frames < np.inf and min(posed[posed > 80]) == tried.first_frame


def test_the_less_may_be_wrong_the_more_views_are_asked(recovered, there_and_back):
    lax, strict = (first_confirmed(recovered, there_and_back, alpha=alpha)[0] for alpha in (0.2, 1e-4))
    assert lax <= 1 < strict


@pytest.fixture(scope="module")
def believed(recovered, there_and_back):
    """What ten views of a place say, and where the camera was there."""
    images, stamps_s, _ = there_and_back
    system = recovered[2].restore()
    reconfigure(system, belief=BeliefConfig(alpha=1e-12))
    feed(system, images[88:105], stamps_s[88:105], check=False)
    return system.engine.search.probation.withdrawn()


def test_a_place_at_which_the_camera_may_as_well_be_counts_against_one_that_it_excludes(
    recovered, there_and_back, believed
):
    """The camera cannot be at both; one from which it can have come says what it said."""
    rival = Withdrawn(0, np.full(3, 1e3), believed.stamp_s, believed.belief)
    same = Withdrawn(0, believed.centre, believed.stamp_s, believed.belief)
    alone, against, again = (
        first_confirmed(recovered, there_and_back, w)[0] for w in ((), (rival,), (same,))
    )
    assert alone <= 2 and against == np.inf and again <= alone


def test_a_recording_that_was_cut_goes_on_at_the_place_that_its_views_prove(there_and_back, monkeypatch):
    """One frame is black, and the camera is where it was two seconds before: no camera is as fast."""
    images, _, _ = there_and_back
    order = [*range(79), 85, *range(15, 79)]
    asked = []
    monkeypatch.setattr(
        "dslab.slam.belief.belief.prior", lambda unseen, *rest: asked.append(unseen) or prior(unseen, *rest)
    )
    system = build_system("base", CAMERA, 0)
    feed(system, [images[i] for i in order], np.arange(len(order)) / CAMERA.fps, check=False)
    (found,) = [e for e in system.events if isinstance(e, Relocalized)]
    assert found.lost_s < 2 and come(asked[-1]) < -1, "it was beyond its reach"


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
