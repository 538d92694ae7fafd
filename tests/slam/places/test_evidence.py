"""What a view should show at a place, and what it shows, in worlds of known points."""

import numpy as np
import pytest
from slam_scenes import PointWorld, rigid, walk

from dslab.slam.optimization.sim3 import sim3_matrix
from dslab.slam.places._evidence_kernels import look_for
from dslab.slam.places.evidence import EvidenceBar, Support, cells_of, support


@pytest.fixture(scope="module")
def known():
    world, rng = PointWorld(points=6000), np.random.default_rng(1)
    seen = [world.see(i, walk(i), rng, noise_px=0.5, bits=6) for i in range(0, 40, 5)]
    built, _ = world.map_of(seen, rng)
    points = built.points().astype(np.int32)
    built.arrays.pt_visible[points], built.arrays.pt_found[points] = 10, 7  # the share that is detected
    return world, built, points


def sighting(world, T_cam_world, hidden=None):
    """A view in which the points of a part of the world are other ones, with other descriptors."""
    rng = np.random.default_rng(5)
    if hidden is None:
        return world.see(500, T_cam_world, rng, noise_px=0.5, bits=6).frame.features
    other = PointWorld(seed=0, points=6000)
    rows = hidden(other.xyz)
    other.descriptor[rows] = rng.integers(0, 2**64, (int(rows.sum()), 4), dtype=np.uint64)
    return other.see(500, T_cam_world, rng, noise_px=0.5, bits=6).frame.features


def test_the_right_place_is_supported_all_over_the_view(known):
    world, built, points = known
    T = rigid((0.05, -0.05, 0.1), (0, 3, 0)) @ walk(18)
    found = support(built, points, T, sighting(world, T), 4.0)
    assert found.expected > 100 and 0.8 < found.share < 1.2
    assert found.extent > 0.4 and found.supported > 0.9 and found.contradicted < 0.03


def test_another_place_and_another_world_are_not_supported(known):
    world, built, points = known
    away = support(built, points, walk(18), sighting(world, rigid((1.0, 0, 0)) @ walk(18)), 4.0)
    other = support(built, points, walk(18), sighting(PointWorld(seed=9, points=6000), walk(18)), 4.0)
    assert max(away.share, other.share) < 0.25 and max(away.extent, other.extent) < 0.06


@pytest.mark.parametrize("aside_m", [0.0, 0.6, 1.2])
def test_a_point_is_expected_as_far_as_it_was_seen_from_near_here(known, aside_m):
    """NumPy twin of the chance: half at 9 degrees from the nearest view, or at 1.74 times its distance."""
    world, built, points = known
    T, m = rigid((0, aside_m, 0)) @ walk(18), built.arrays
    f = sighting(world, T)
    rows, _, _, chance, _ = look_for(
        m, built.view, T, 1.0, points, f.xy, f.octave, f.descriptors, f.cell_start, 0, 4.0, True
    )
    centre, centres = (
        -T[:3, :3].T @ T[:3, 3],
        -np.einsum("kji,kj->ki", m.kf_T_cam_map[:8, :3, :3], m.kf_T_cam_map[:8, :3, 3]),
    )
    for p, found in zip(rows, chance, strict=True):
        seen_from = centres[[k for k in range(8) if p in built.observed_points(k)]]
        here, there = m.pt_xyz[p] - centre, m.pt_xyz[p] - seen_from
        near, far = np.linalg.norm(here), np.linalg.norm(there, axis=1)
        turn_deg = np.rad2deg(np.arccos(np.clip(there @ here / (near * far), -1, 1)))
        unfamiliar = (turn_deg / 9) ** 2 + (np.log2(near / far) / 0.8) ** 2
        assert found == pytest.approx(8 / 12 / (1 + unfamiliar.min() ** 0.75)) and found >= 0.1
    assert len(rows) > 50 and (aside_m > 0) == (chance.mean() < 0.6)


def test_a_part_of_the_view_that_shows_something_else_contradicts(known):
    world, built, points = known
    changed = sighting(world, walk(18), hidden=lambda xyz: xyz[:, 1] < -0.5)
    found = support(built, points, walk(18), changed, 4.0)
    assert 0.2 < found.contradicted < 0.6
    assert found.supported < 0.8 and found.supported + found.contradicted <= 1 + 1e-9


@pytest.mark.parametrize(("chance", "against"), [(0.9, True), (0.3, False)])
def test_a_few_points_that_are_rarely_found_contradict_nothing(known, chance, against):
    """Three points of a cell are missing: of those found three times in ten that is usual, of others not."""
    world, built, points = known
    built = built.copy()
    f = sighting(world, walk(18))
    rows, pixels, _, _, keypoint = look_for(
        built.arrays, built.view, walk(18), 1.0, points,
        f.xy, f.octave, f.descriptors, f.cell_start, 0, 4.0, False,
    )  # fmt: skip
    cell = cells_of(built.view, pixels)
    found, missing = rows[keypoint >= 0], rows[keypoint < 0]
    alone = next(c for c in np.unique(cell) if (cell[keypoint < 0] == c).sum() >= 3)
    few = missing[cell[keypoint < 0] == alone][:3]
    kept = np.concatenate([few, found[cell[keypoint >= 0] != alone]])
    a = built.arrays
    a.pt_visible[kept], a.pt_found[kept] = 998, 899
    a.pt_found[few] = round(chance * 1000) - 1
    seen = support(built, kept, walk(18), f, 4.0)
    assert (seen.contradicted > 0) == against


def test_a_wide_image_needs_no_larger_part_of_it_to_speak(known):
    """Points in the left half of the image speak for as much of a strip of it as of all of it."""
    world, built, points = known
    f = sighting(world, walk(18))
    left = points[(built.arrays.pt_xyz[points] @ walk(18)[:3, :3].T + walk(18)[:3, 3])[:, 0] < 0]
    strip, height = built.copy(), built.view.y_max - built.view.y_min
    strip.view = built.view._replace(y_max=built.view.y_min + 0.4 * height)
    whole, wide = (support(m, left, walk(18), f, 4.0).extent for m in (built, strip))
    assert 0.35 < whole < 0.6 and wide == pytest.approx(whole, abs=0.1)


def test_a_similarity_gives_what_the_scaled_map_gives(known):
    world, built, points = known
    features = sighting(world, walk(18))
    same = support(built, points, walk(18), features, 4.0)
    larger = built.copy()
    larger.transform(2.0, np.eye(3), np.zeros(3))
    S = walk(18) @ sim3_matrix(0.5, np.eye(3), np.zeros(3))
    scaled = support(larger, points, S, features, 4.0)
    assert (scaled.found, scaled.extent) == (same.found, same.extent)
    assert scaled.expected == pytest.approx(same.expected)


def test_a_view_that_should_show_nothing_says_nothing(known):
    world, built, points = known
    behind = rigid((0, 0, 0), (0, 180, 0)) @ walk(18)
    nothing = support(built, points, behind, sighting(world, walk(18)), 4.0)
    assert (nothing.expected, nothing.found, nothing.share, nothing.extent) == (0, 0, 0, 0)


def test_a_view_that_shows_far_more_than_it_should_is_unknown():
    seen = Support(50.0, 90, 0.4, 1.0, 0.0)
    assert EvidenceBar(0.5, 0.2, 0.16).fault(seen) == ""
    assert EvidenceBar(0.5, 0.2, 0.16, 1.7).fault(seen) == "view_is_unknown"
