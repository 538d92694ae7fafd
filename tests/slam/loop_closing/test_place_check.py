"""What the keyframes on either side say of a similarity between two maps."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import PointWorld, rigid, walk

from dslab.slam.loop_closing.correction import Loop
from dslab.slam.loop_closing.detection import LoopClosingConfig, LoopDetector
from dslab.slam.loop_closing.look_alikes import look_alikes, note_look_alike
from dslab.slam.loop_closing.map_alignment import Agreement, Alignment, Sim3AlignmentConfig, align
from dslab.slam.loop_closing.place_check import PlaceCheckConfig, double_in_reach, fault_of_alignment
from dslab.slam.map._map_kernels import median_depth
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_matrix
from dslab.slam.places.recognition import KeyframeDatabase
from dslab.slam.tracking.reach import ReachConfig

LAX = Sim3AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20)
ANYWHERE = PlaceCheckConfig(reach=ReachConfig(factor=1e6))


def rng():
    return np.random.default_rng(0)


def maps(world_2=None, later=0):
    """Two maps of one path, the second at twice the size, seen later and in a world that may differ."""
    world, r = PointWorld(points=6000), np.random.default_rng(1)
    built = []
    for m, (w, start) in enumerate([(world, 0), (world_2 or world, later)]):
        seen = [w.see(start + i, walk(i), r, noise_px=0.5, bits=6) for i in range(20 * m, 60, 5)]
        made, _ = w.map_of(seen, r, map_id=m)
        points = made.points()
        made.arrays.pt_visible[points], made.arrays.pt_found[points] = 10, 7
        built.append(made)
    built[1].transform(2.0, np.eye(3), np.array([1.0, 0.0, 0.0]))
    return built


def changed(share_of_path):
    """The world, with other things from a part of the path on."""
    world = PointWorld(points=6000)
    other = world.xyz[:, 0] > np.quantile(world.xyz[:, 0], share_of_path)
    draws = np.random.default_rng(3).integers(0, 2**64, (int(other.sum()), 4), dtype=np.uint64)
    world.descriptor[other] = draws
    return world


def found(old, new):
    alignment, _, _ = align(old, new, 6, 2, rng(), LAX)
    assert alignment is not None
    return alignment


def test_one_place_seen_twice_is_not_doubted():
    old, new = maps()
    assert fault_of_alignment(old, new, found(old, new), rng(), ANYWHERE) == ""


def test_a_similarity_to_another_place_is_doubted():
    old, new = maps()
    right = found(old, new)
    aside = replace(right, S_old_new=rigid((0.6, 0, 0)) @ right.S_old_new)
    larger = replace(right, S_old_new=right.S_old_new @ sim3_matrix(1.2, np.eye(3), np.zeros(3)))
    for wrong in (aside, larger):
        assert fault_of_alignment(old, new, wrong, rng(), ANYWHERE) == "expected_points_missing"


def test_surroundings_that_differ_in_part_are_doubted():
    """A poster and little more is the same: enough for an alignment, not for a place."""
    old, new = maps(changed(0.27))
    assert fault_of_alignment(old, new, found(old, new), rng(), ANYWHERE) in (
        "contradicted",
        "expected_points_missing",
    )


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        ({"bar": replace(ANYWHERE.bar, min_share=1.1)}, "expected_points_missing"),
        ({"agreement": Agreement(0.0, 0.0, 0.0)}, "neighbours_disagree"),
    ],
)
def test_the_reason_names_the_bar(config, reason):
    old, new = maps()
    assert fault_of_alignment(old, new, found(old, new), rng(), replace(ANYWHERE, **config)) == reason


def test_maps_far_apart_in_space_but_not_in_time_are_out_of_reach():
    """The second map begins where the first was half a minute ago: there was no time to get back."""
    soon, late = maps(later=56 + 3), maps(later=56 + 30 * 30)
    reach = PlaceCheckConfig(reach=ReachConfig(factor=0.3))
    assert fault_of_alignment(*soon, found(*soon), rng(), reach) == "out_of_reach"
    assert fault_of_alignment(*late, found(*late), rng(), reach) == ""


def test_more_is_asked_of_maps_that_are_far_apart_in_time():
    """Half a minute later the camera can be anywhere; half a second later it cannot."""
    lax = replace(ANYWHERE.bar, min_share=0.0, max_contradicted=1.0, min_extent=0.0)
    config = replace(ANYWHERE, bar=lax, far_bar=replace(lax, max_share=0.1))
    for later, reason in ((56 + 15, ""), (56 + 30 * 30, "view_is_unknown")):
        old, new = maps(later=later)
        assert fault_of_alignment(old, new, found(old, new), rng(), config) == reason


def test_a_place_has_a_double_in_reach():
    """The old map has met look-alikes: two places, or any others as far apart, may show the same."""
    reach = PlaceCheckConfig(reach=ReachConfig(factor=0.3))
    for shift, in_reach in ((1.5, True), (1e5, False)):
        old, new = maps(later=56 + 30 * 30)
        A = rigid((shift, 0, 0), (0, 180, 0))
        S = old.T_cam_map(6) @ A @ np.linalg.inv(old.T_cam_map(1))
        old.look_alikes.append((1, 6, S))
        assert look_alikes(old)[0] == pytest.approx(A, abs=1e-9)
        assert double_in_reach(old, new, found(old, new).S_old_new, reach) is in_reach
        assert double_in_reach(new, old, found(new, old).S_old_new, reach) is in_reach


# -- look-alikes ---------------------------------------------------------------------------------------------


def refuted(m, double):
    """A loop between keyframes 6 and 1 that puts the former's surroundings where ``double`` does."""
    none = np.empty(0, np.int32)
    return Loop(6, 1, np.eye(4), none, none, Alignment(double, 1.0, 0, 1, 6, none, none))


def test_a_map_remembers_the_doubles_that_its_geometry_has_refuted():
    old, _ = maps()
    half_turn = rigid((0.5, 0, 0), (0, 0, 180))
    note_look_alike(old, refuted(old, half_turn))
    note_look_alike(old, refuted(old, half_turn))
    assert len(old.look_alikes) == 1 and look_alikes(old)[0] == pytest.approx(half_turn, abs=1e-9)
    note_look_alike(old, refuted(old, rigid((200.0, 0, 0))))
    assert len(old.look_alikes) == 2


def test_what_may_be_drift_is_no_double():
    old, _ = maps()
    depth = median_depth(old.arrays, 6)
    note_look_alike(old, refuted(old, rigid((0.5 * depth, 0, 0), (0, 5, 0))))
    assert old.look_alikes == []


def test_doubles_follow_the_map_through_every_change():
    old, new = maps()
    new.look_alikes.append((1, 6, rigid((3, 1, 0), (0, 90, 0))))
    (before,), G = look_alikes(new), sim3_matrix(0.5, rigid((0, 0, 0), (10, 20, 30))[:3, :3], np.ones(3))
    copied = new.copy()
    copied.transform(*sim3_decompose(G))
    expected = G @ before @ np.linalg.inv(G)
    assert look_alikes(copied)[0] == pytest.approx(expected, abs=1e-9)
    assert look_alikes(new)[0] == pytest.approx(before, abs=1e-9), "a copy is independent"
    old.absorb(copied)
    assert look_alikes(old)[0] == pytest.approx(expected, abs=1e-9)
    S = np.array([new.T_cam_map(k) for k in range(new.n_keyframes)]) @ np.linalg.inv(G)
    new.move_keyframes(S)
    assert look_alikes(new)[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("reason", "count"), [("map_is_stretched", 1), ("map_has_changed", 0)])
def test_only_what_the_geometry_refutes_is_remembered(reason, count):
    old, _ = maps()
    detector = LoopDetector(old, KeyframeDatabase(old), LoopClosingConfig(), PlaceCheckConfig())
    refusal = detector.refused(refuted(old, rigid((0.5, 0, 0), (0, 0, 180))), reason)
    assert refusal.reason == reason and len(old.look_alikes) == count
