"""Where a saved map may be: what views say over a time, and which hypotheses exclude each other."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import PointWorld, rigid, tracked_in, walk

from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.fusion.hypotheses import Hypothesis, rival
from dslab.slam.dual.fusion.place_merging import PlaceMerger
from dslab.slam.loop_closing.map_alignment import Sim3AlignmentConfig, align
from dslab.slam.loop_closing.place_check import PlaceCheckConfig
from dslab.slam.tracking.reach import ReachConfig
from dslab.slam.tracking.relocalization import RelocalizationOutcome

LAX = Sim3AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20)
LATER = 900  # frames, half a minute


def place_of(asked_s=0.5, reach=1e6):
    return PlaceCheckConfig(far_max_s=asked_s, reach=ReachConfig(factor=reach))


def merger_of(asked_s=0.5, **config):
    return PlaceMerger(FusionConfig(confirmations=1, **config), place_of(asked_s), 0)


@pytest.fixture(scope="module")
def two_maps():
    """A path, and the same again half a minute later, every fifth frame a keyframe."""
    world, rng = PointWorld(points=6000), np.random.default_rng(1)
    built = []
    for m in (0, 1):
        seen = [world.see(m * LATER + i, walk(i), rng, noise_px=0.5, bits=6) for i in range(20 * m, 60, 5)]
        made, _ = world.map_of(seen, rng, map_id=m)
        points = made.points()
        made.arrays.pt_visible[points], made.arrays.pt_found[points] = 10, 7
        built.append(made)
    return built


def aligned(old, new):
    alignment, _, _ = align(old, new, 4, 0, np.random.default_rng(0), LAX)
    assert alignment is not None
    return alignment


def asked(hypothesis, new, config):
    """Accepted alignments after the view of each keyframe, in turn."""
    found = []
    for k in range(new.n_keyframes):
        hypothesis.look(new, k, config)
        found.append(len(hypothesis.accepted(new, config, 1)) if hypothesis.verdicts else 0)
    return found


def test_a_join_takes_the_sound_views_of_a_time(two_maps):
    """Keyframes are a sixth of a second apart: half a second is four of them."""
    old, new = two_maps
    right = Hypothesis(old, [aligned(old, new)])
    assert asked(right, new, place_of(0.5)) == [0, 0, 0, 1, 1, 1, 1, 1]
    assert set(right.verdicts.values()) == {""}
    assert not any(asked(Hypothesis(old, [aligned(old, new)]), new, place_of(9.0)))


def test_views_speak_against_a_wrong_place(two_maps):
    old, new = two_maps
    right = aligned(old, new)
    wrong = Hypothesis(old, [replace(right, S_old_new=rigid((0.6, 0, 0)) @ right.S_old_new)])
    assert not any(asked(wrong, new, place_of(0.5)))
    assert not wrong.is_sound(0.5) and "expected_points_missing" in wrong.verdicts.values()


def test_what_views_of_one_map_say_does_not_count_for_the_next(two_maps):
    """A later map has keyframes of the same numbers, or fewer."""
    old, new = two_maps
    merger = merger_of()
    merger.skip(new)
    merger._hypotheses.append(Hypothesis(old, [aligned(old, new)], dict.fromkeys(range(8), "")))
    merger.skip(new)
    assert merger._decided(new)
    later = new.copy()
    later.map_id = 2
    merger.skip(later)
    assert not merger._decided(later)


def test_what_spoke_against_it_before_counts(two_maps):
    old, new = two_maps
    burdened = Hypothesis(old, [aligned(old, new)], {0: "contradicted", 1: "contradicted"})
    assert not any(asked(burdened, new, place_of(0.5))[:7])


def test_two_places_of_one_map_are_rivals_and_a_place_is_none_of_itself(two_maps):
    old, new = two_maps
    right = aligned(old, new)
    one, again = (
        Hypothesis(old, [right]),
        Hypothesis(old, [replace(right, S_old_new=rigid((0.1, 0, 0)) @ right.S_old_new)]),
    )
    away = Hypothesis(old, [replace(right, S_old_new=rigid((30.0, 0, 0)) @ right.S_old_new)])
    assert not rival(one, again, place_of()) and rival(one, away, place_of())


@pytest.mark.parametrize(("metres", "excluded"), [(0.0, False), (500.0, True)])
def test_places_of_two_maps_are_rivals_if_the_camera_cannot_have_come_from_one_to_the_other(
    two_maps, metres, excluded
):
    """Of two saved maps, the later begins where the earlier one ended, or far from there."""
    old, new = two_maps
    right = aligned(old, new)
    other = old.copy()
    other.map_id = 7
    other.transform(1.0, np.eye(3), np.array([metres, 0.0, 0.0]))
    there = replace(right, old_map_id=7)
    assert rival(Hypothesis(old, [right]), Hypothesis(other, [there]), place_of(reach=1.25)) is excluded


def test_a_rival_that_has_shown_much_less_does_not_count(two_maps):
    old, new = two_maps
    strong = Hypothesis(old, [aligned(old, new)], dict.fromkeys(range(8), ""))
    weak = Hypothesis(old, [aligned(old, new)], dict.fromkeys(range(3), ""))
    assert not weak.is_nearly_as_good_as(strong, 0.75) and strong.is_nearly_as_good_as(weak, 0.75)


@pytest.mark.parametrize(("views", "accepted"), [(6, False), (2, True)])
def test_a_join_with_a_rival_that_does_nearly_as_well_is_ambiguous(two_maps, views, accepted):
    old, new = two_maps
    right = aligned(old, new)
    away = replace(right, S_old_new=rigid((30.0, 0, 0)) @ right.S_old_new)
    merger = merger_of()
    merger._hypotheses = [
        Hypothesis(old, [right], dict.fromkeys(range(8), "")),
        Hypothesis(old, [away], dict.fromkeys(range(views), "")),
    ]
    merger._hypotheses[1].verdicts[7] = "contradicted"
    assert bool(merger._decided(new)) is accepted
    assert [reason for _, reason in merger.refused] == ([] if accepted else ["ambiguous"])


class FoundByOneView:
    """Place recognition that knows of a keyframe which shares nothing, and places a view nevertheless."""

    def __init__(self, placed):
        self.database = self.relocalizer = self
        self._placed = placed

    def relocalization_candidates(self, bow):
        return [0]

    def relocalize(self, frame, rng, similar):
        assert similar == [0]
        frame.point[:], frame.T_cam_map = self._placed.point, self._placed.T_cam_map
        frame.reference_keyframe = self._placed.reference_keyframe
        return RelocalizationOutcome(True, 0, 50, 50)


def test_a_view_finds_a_map_that_none_of_its_keyframes_aligns_with():
    world, rng = PointWorld(points=6000), np.random.default_rng(1)
    old, of_old = world.map_of([world.see(i, walk(i), rng, noise_px=0.5) for i in range(0, 300, 5)], rng)
    seen = [world.see(LATER + i, walk(i), rng, noise_px=0.5) for i in (295, 299)]
    new, _ = world.map_of(seen, rng, map_id=1)
    new.transform(2.0, np.eye(3), np.array([1.0, 0.0, 0.0]))
    for k in range(2):
        assert align(old, new, 0, k, rng, LAX)[0] is None
    placed = tracked_in(old, of_old, seen[0], 59)
    merger = merger_of(0.0, min_matches=20)
    merger.search(new, [old], lambda _: FoundByOneView(placed), nullcontext())
    found = merger._hypotheses[0].alignments[0]
    assert found.scale == pytest.approx(0.5, rel=0.02) and found.old_keyframe == 59
    assert found.S_old_new @ [1.0, 0.0, 0.0, 1.0] == pytest.approx([0, 0, 0, 1], abs=0.2)
