"""Several ways back to a saved map at once: the first one counts, and the others end."""

from dataclasses import replace

import numpy as np
import pytest
from dual_scenes import RECOVERY_ONLY, STEP_M, dual, of, with_own_threads
from slam_scenes import blanked, check_maps, errors_m, feed, kinds, reconfigure, rms, toy
from test_dual_lifecycle import Lasting

from dslab.slam.belief.config import BeliefConfig
from dslab.slam.belief.fitted import fitted
from dslab.slam.core.events import TrackingState
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.fusion.fuse import FusionConfig

BLANK = range(50, 56)


def there_and_back(turn):
    """The camera goes on to frame ``turn`` of a toy sequence and back to frame 20."""
    images, _, T_world_cam = toy(130, 0, STEP_M)
    order = [*range(turn), *range(turn - 1, 19, -1)]
    return [images[i] for i in order], np.arange(len(order)) / 30.0, T_world_cam[order]


def beside_a_new_scene(both=68):
    """Two scenes side by side: first one is lit, on the way back the other, from frame ``both`` on both."""
    (here, _, T_world_cam), (there, _, _) = toy(70, 0, STEP_M), toy(70, 7, STEP_M)
    order, images = [*range(56), *range(60, 19, -1)], []
    half = here[0].shape[1] // 3
    for n, i in enumerate(order):
        image = np.full_like(here[i], 120)
        if n < 56 or n >= both:
            image[:, half:] = here[i][:, half:]
        if n >= 56:
            image[:, :half] = there[i][:, :half]
        images.append(image)
    return blanked(images, BLANK), np.arange(len(order)) / 30.0, T_world_cam[order]


@pytest.fixture
def changeable(monkeypatch):
    """Of places it is believed that a third is often another scene, and of no other that they look so."""
    given = replace(fitted(), here=(4.0, 2.0), alike=(0.5, 2.0))
    monkeypatch.setattr("dslab.slam.belief.belief.fitted", lambda: given)


@pytest.mark.parametrize("relocalization", [True, False])
@pytest.mark.slow
def test_a_small_new_map_is_dropped_where_a_saved_one_is_found_again(relocalization, changeable):
    images, stamps_s, truth = beside_a_new_scene()
    system = dual(replace(RECOVERY_ONLY, relocalization=relocalization, start_keyframes=50))
    results = feed(system, images, stamps_s)
    if not relocalization:
        assert "map_dropped" not in kinds(system) and sorted(system.maps()) == [0, 1]
        return
    (dropped,) = of(system, "map_dropped")
    (back,) = of(system, "relocalized")
    assert (dropped.reason, dropped.map_id, dropped.frame) == ("returned_to_saved_map", 1, back.frame)
    assert (back.map_id, system.maps(), system.current_map_id) == (0, [0], 0)
    assert all(r.state is TrackingState.TRACKING for r in results[back.frame - 5 :])
    assert all(r.map_id == 0 for r in results[back.frame :])
    assert system.engine.store.saved == [] and not system.buffer.frozen
    (path,) = system.trajectories()
    assert path.frames[-1] == len(images) - 1 and rms(errors_m(path, truth)[0]) < 0.05


def test_a_place_that_is_all_but_confirmed_counts_though_a_recovery_has_begun_meanwhile(changeable):
    """The recovery would fail: the scene of the new map was not lit before."""
    images, stamps_s, _ = beside_a_new_scene(both=65)
    system = with_own_threads([Lasting(200)], relocalization=True, start_keyframes=4)
    reconfigure(system, belief=BeliefConfig(alpha=1e-3))
    feed(system, images, stamps_s)
    (start,), (end,), (dropped,), (back,) = (
        of(system, k) for k in ("recovery_start", "recovery_end", "map_dropped", "relocalized")
    )
    assert back.first_frame < start.frame < back.frame == dropped.frame == end.frame
    assert (end.stage, end.reason) == ("cancelled", dropped.reason) == ("cancelled", "returned_to_saved_map")
    assert system.maps() == [0] and not system.engine.store.saved and not system.buffer.frozen


@pytest.mark.parametrize("exhaustive", [False, True])
@pytest.mark.slow
def test_a_recovery_ends_when_its_maps_are_joined_by_place(exhaustive):
    """Unless all threads are to be run to their end."""
    images, stamps_s, _ = toy(130, 0, STEP_M)
    system = with_own_threads(
        [Lasting(70)], start_keyframes=3, place_merging=FusionConfig(), exhaustive=exhaustive
    )
    feed(system, blanked(images, BLANK), stamps_s)
    (joined,), (end,) = of(system, "fusion"), of(system, "recovery_end")
    assert joined.by == "place" and system.maps() == [0]
    if exhaustive:
        assert end.success and end.frame > joined.frame
    else:
        assert (end.stage, end.reason, end.frame) == ("cancelled", "maps_are_joined", joined.frame)


@pytest.mark.slow
def test_a_recovery_is_fused_into_a_map_that_has_been_tracked_on_since():
    """The camera is back in the old map while the recovery runs, and the new map is left behind."""
    images, stamps_s, truth = there_and_back(100)
    system = with_own_threads([Lasting(80)])
    shown = blanked(images, BLANK, range(100, 140))
    for image, stamp_s in zip(shown[:100], stamps_s[:100], strict=True):
        system.process(image, float(stamp_s))
    system.dual = replace(system.dual, relocalization=True)
    often = replace(system.config.tracking, keyframe_information=1.0)  # known ground asks for no keyframe
    reconfigure(system, tracking=often, belief=BeliefConfig(alpha=0.2))
    relocalize = system.engine.relocalize
    system.engine.relocalize = lambda frame, ids, *rest: relocalize(frame, [0], *rest)
    feed(system, shown[100:], stamps_s[100:])
    (start,), (back,), (fused,) = (of(system, k) for k in ("recovery_start", "relocalized", "fusion"))
    assert back.map_id == 0 and start.frame < back.frame < fused.frame
    assert (fused.old_map_id, fused.new_map_id, fused.by) == (0, 1, "recovery")
    assert system.maps() == [0] and system.state is TrackingState.TRACKING
    keyframes = system.keyframe_trajectories()[0].frames
    assert (keyframes > back.frame).any(), "what was made since the return stays"
    (path,) = system.trajectories()
    assert rms(errors_m(path, truth)[0]) < 0.06
    check_maps(system)


def test_settings_are_checked():
    with pytest.raises(ValueError, match=r"workers\n.*greater than or equal to 1"):
        DualConfig(workers=0)
    with pytest.raises(ValueError, match=r"must be ThreadSpec.*'orb'"):
        DualConfig(recovery_threads=("orb", "sift"))


def test_a_place_is_judged_by_as_many_features_as_in_the_base():
    """While a map is sought a frame has many more, which would show more of any place."""
    images, stamps_s, _ = toy(110, 0, STEP_M)
    system, offered = dual(replace(RECOVERY_ONLY, relocalization=True)), []
    offer = system.engine.search.offer
    system.engine.search.offer = lambda frame, *rest: (
        offered.append(len(frame.features)),
        offer(frame, *rest),
    )[1]
    feed(system, blanked(images, BLANK), stamps_s, check=False)
    usual = system.engine.config.orb.n_features
    assert offered and max(offered) <= usual
    assert of(system, "relocalized"), "found, and on the frames that were counted"
