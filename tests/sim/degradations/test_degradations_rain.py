"""Rain: number, size and speed of its drops, its streaks, and the drops on the glass."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from degradation_worlds import small_scenario
from scipy.integrate import quad

from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.sim.degradations.base import streams_of
from dslab.sim.degradations.image import View
from dslab.sim.degradations.raindrops import (
    BOX_M,
    MOST_MMPH,
    RainField,
    draw_drops,
    drops_per_m3,
    extinction_per_m,
    fall_mps,
)
from dslab.sim.degradations.registry import IMAGE_KINDS
from dslab.sim.degradations.wet_glass import WetGlass, merge, paint_drops, radius_of
from dslab.sim.sensors.camera import Intrinsics

CAMERA = Intrinsics(160, 120, 120.0, 120.0, 79.5, 59.5, 30.0)
K = np.array([120.0, 120.0, 79.5, 59.5])
LEVEL = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
NO_DEPTH = np.zeros((120, 160), np.float32)


def density(diameter_mm: float, rate: float) -> float:
    return 8000 * np.exp(-4.1 * rate**-0.21 * diameter_mm)


@pytest.mark.parametrize("rate", [5.0, 300.0])
def test_drops_have_marshall_and_palmers_number_and_sizes(rate):
    number = quad(density, 1, 50, args=(rate,))[0]
    assert drops_per_m3(rate, 1.0) == pytest.approx(number, rel=1e-6)
    drawn = round(drops_per_m3(MOST_MMPH, 1.0) * 200)
    diameter_mm, from_mmph = draw_drops(drawn, 1.0, np.random.default_rng(0))
    there = diameter_mm[from_mmph <= rate]
    assert len(there) == pytest.approx(200 * number, rel=0.03)
    assert there.mean() == pytest.approx(1 + 1 / (4.1 * rate**-0.21), rel=0.02)


def test_extinction_is_twice_the_area_of_all_drops():
    area = quad(lambda d: density(d, 40.0) * np.pi / 4 * (d / 1000) ** 2, 0, 50)[0]
    assert extinction_per_m(40.0) == pytest.approx(2 * area, rel=1e-6)
    assert extinction_per_m(0.0) == 0


def test_drops_fall_at_the_measured_speeds():
    # Source: Gunn and Kinzer, 1949.
    np.testing.assert_allclose(fall_mps(np.array([1.0, 2.0, 4.0])), [4.03, 6.49, 8.83], rtol=0.04)


def one_drop(place_m, velocity_mps=(0, 0, -6.0), diameter_m=0.004) -> RainField:
    as_float = partial(np.array, dtype=np.float32)
    return RainField(as_float([place_m]), as_float([velocity_mps]), as_float([diameter_m]), as_float([1.0]))


def withheld(field: RainField, stamp_s: float, exposure_s: float, depth_m=NO_DEPTH) -> np.ndarray:
    return 1 - field.passing(depth_m, K, LEVEL, LEVEL, stamp_s, exposure_s, 10.0)


@pytest.mark.parametrize("exposure_s", [0.001, 0.01, 0.04])
def test_a_streak_has_the_length_of_the_fall_and_the_light_of_the_drop(exposure_s):
    field = one_drop((0.0, 1.5, 0.0))
    share = withheld(field, 0.0, exposure_s)
    rows, columns = np.nonzero(share > 0.02 * share.max())
    fallen_px = 6.0 * exposure_s * 120 / 1.5
    assert np.ptp(rows) == pytest.approx(fallen_px, abs=2.5) and np.ptp(columns) <= 2
    assert rows.mean() == pytest.approx(59.5, abs=1) and columns.mean() == pytest.approx(79.5, abs=1)
    size_px = 120 * 0.004 / 1.5
    assert share.sum() == pytest.approx(np.pi / 4 * size_px**2, rel=0.15)


def test_a_drop_is_hidden_by_nearer_surfaces():
    field = one_drop((0.0, 1.5, 0.0))
    assert withheld(field, 0.0, 0.01, np.full_like(NO_DEPTH, 1.4)).max() == 0
    assert withheld(field, 0.0, 0.01, np.full_like(NO_DEPTH, 1.6)).max() > 0


def test_a_drop_falls_from_frame_to_frame_and_the_box_repeats():
    field = one_drop((0.1, 2.0, 0.1), velocity_mps=(0.5, 0, -5.0))
    middles = []
    for stamp_s in (0.0, 0.02, BOX_M / 5.0):
        share = withheld(field, stamp_s, 0.001)
        rows, columns = np.indices(share.shape)
        middles.append(((rows * share).sum() / share.sum(), (columns * share).sum() / share.sum()))
    moved = np.subtract(middles[1], middles[0])
    np.testing.assert_allclose(moved, [5.0 * 0.02 * 60, 0.5 * 0.02 * 60], atol=0.3)
    # After one fall through the box it is back at its height, moved by the wind.
    np.testing.assert_allclose(np.subtract(middles[2], middles[0]), [0, 0.5 * BOX_M / 5 * 60], atol=0.3)


def filter_of(rate: float, seed: int = 0, **more):
    segment = SEGMENT_KINDS["rain"](kind="rain", start_s=0, duration_s=10, rate_mmph=rate, **more)
    return IMAGE_KINDS["rain"].prepare(segment, CAMERA, partial(streams_of, seed, segment))


def test_more_rain_withholds_more_and_drops_under_a_roof_stay_off_the_glass():
    image = np.random.default_rng(0).integers(0, 256, (120, 160), dtype=np.uint8)
    shares = [filter_of(rate)(image, View(0, 1.0, 1.0))[1] for rate in (0, 3, 20, 80, 300)]
    assert shares[0] == 0 and all(a < b for a, b in pairwise(shares))
    assert filter_of(80, glass_mm=0)(image, View(0, 1.0, 1.0))[1] < 0.3 * shares[3]
    # At its onset, rain has not wetted the glass yet.
    dry = filter_of(80, wet_s=0)
    wetting = [dry(image, View(0, stamp_s, 1.0))[1] for stamp_s in (0.0, 3.0, 9.0)]
    assert wetting[0] < wetting[1] < wetting[2]


def test_longer_views_see_less_through_rain():
    image, depth_m = np.full((120, 160), 60, np.uint8), np.full((120, 160), 5.0, np.float32)
    depth_m[:, 80:] = 200
    image[:60] = 220
    out, _ = filter_of(100, glass_mm=0)(image, View(0, 1.0, 1.0, depth_m))
    near, far = out[60:, :80].mean(), out[60:, 80:].mean()
    assert near < 75 and far > 100


def glass(rate: float = 100.0, until_s: float = 30.0) -> WetGlass:
    rng = np.random.default_rng(2)
    return WetGlass.from_rain(CAMERA, 30.0, rate, 3.0, (0.0, until_s), rng)


def test_drops_on_the_glass_stay_grow_and_run_down_when_too_heavy():
    wet = glass()
    places = [
        {tuple(np.round(d[:2], 2)): d[2] for d in wet.drops_px(CAMERA, t, 100.0)} for t in (20.0, 20.5, 29.0)
    ]
    kept = set(places[0]) & set(places[1])
    assert len(kept) > 0.8 * len(places[0])
    assert all(places[1][p] >= places[0][p] - 1e-3 for p in kept)
    assert any(places[2].get(p, 0) > places[0][p] * 1.05 for p in places[0])
    runners = np.flatnonzero(np.isfinite(wet.run_s) & (wet.run_s < 28))
    assert len(runners)
    volume = np.bincount(wet.parent, wet.volume_mm3, len(wet.land_s))
    assert radius_of(volume[runners]).min() > 2.7 > radius_of(volume[np.isinf(wet.run_s)]).max()


def test_a_stronger_rain_has_all_drops_of_a_weaker_one():
    weak, strong = glass(20.0), glass(200.0)
    there = {tuple(p) for p in strong.place_mm}
    assert 0 < len(weak.land_s) < len(strong.land_s)
    assert all(tuple(p) in there for p in weak.place_mm)


def test_merging_agrees_with_python():
    rng = np.random.default_rng(3)
    land_s, place, volume = (
        np.sort(rng.uniform(0, 9, 150)),
        rng.uniform(0, 12, (150, 2)),
        rng.uniform(1, 9, 150),
    )
    parent, run_s = merge(land_s, place, volume)
    whole, held, expected, runs = {}, [], [], np.full(150, np.inf)
    for drop in range(150):
        near = [
            other for other in held if np.linalg.norm(place[drop] - place[other]) < radius_of(whole[other])
        ]
        # With two in reach, the kernel chooses.
        into = int(parent[drop]) if parent[drop] in near else (near[0] if near else drop)
        expected.append(into)
        whole[into] = whole.get(into, 0) + volume[drop]
        held += [drop] if into == drop else []
        if radius_of(whole[into]) > 2.7:
            runs[into] = land_s[drop]
            held.remove(into)
    np.testing.assert_array_equal(parent, expected)
    np.testing.assert_array_equal(run_s, runs)


def test_a_drop_shows_the_scene_upside_down():
    coarse = np.repeat(np.linspace(0, 1, 12, dtype=np.float32)[:, None], 16, axis=1)
    cover, through = np.zeros((120, 160), np.float32), np.zeros((120, 160), np.float32)
    drops = np.array([[80, 60, 20]], np.float32)
    paint_drops(drops, np.float32(4), np.ascontiguousarray(coarse), cover, through)
    rows, columns = np.indices(cover.shape)
    away = np.hypot(rows - 60, columns - 80)
    np.testing.assert_allclose(cover, np.clip((22 - away) / 4, 0, 1), atol=1e-5)
    assert through[48, 80] > through[60, 80] > through[72, 80]


def test_rain_is_the_same_when_frames_between_are_left_out():
    image = np.random.default_rng(0).integers(0, 256, (120, 160), dtype=np.uint8)
    every, few = filter_of(60), filter_of(60)
    for index in range(5):
        last = every(image, View(index, index / 30, 1.0))[0]
    np.testing.assert_array_equal(few(image, View(4, 4 / 30, 1.0))[0], last)


def test_an_impossible_rain_rate_is_refused():
    with pytest.raises(ValueError, match="less than or equal to 300"):
        small_scenario("room", {"kind": "rain", "start_s": 0, "duration_s": 0.5, "rate_mmph": 3000})
