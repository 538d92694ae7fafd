"""Random scenarios are valid, small, of every kind, and fixed by their seed."""

from itertools import combinations

import pytest

from dslab.scenarios.loading import dump_yaml, load_scenario
from dslab.scenarios.random_scenarios import SEVERITIES, random_scenario
from dslab.scenarios.segments import ImageSegment
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.sim.worlds import layout

DRAWN = [random_scenario(seed) for seed in range(80)]


def test_random_scenarios_are_small_and_short():
    for s in DRAWN:
        assert (s.camera.width_px, s.camera.height_px, s.camera.fps, s.duration_s) == (320, 240, 15, 10)
        assert s.frame_count == 150


def test_every_world_and_every_kind_of_degradation_comes_up():
    worlds = {"room", "corridor", "building", "warehouse", "city", "motorway", "field"}
    assert {s.world.kind for s in DRAWN} == worlds
    assert set(SEVERITIES) == set(DEGRADATIONS)
    assert {g.kind for s in DRAWN for g in s.segments} == set(DEGRADATIONS)


def test_some_worlds_repeat_themselves():
    aliased = [s for s in DRAWN if s.world.aliased]
    assert 8 < len(aliased) < 35
    assert len({s.world.kind for s in aliased}) >= 4


def test_segments_overlap_follow_each_other_and_start_with_the_first_frame():
    counts = [len(s.segments) for s in DRAWN]
    assert min(counts) <= 4 and max(counts) >= 25
    assert 15 <= sum(any(g.start_s == 0 for g in s.segments) for s in DRAWN) <= 75
    pairs = [pair for s in DRAWN for pair in combinations(s.segments, 2)]
    assert sum(a.end_s == b.start_s for a, b in pairs) > 200
    assert sum(a.start_s < b.start_s < a.end_s for a, b in pairs) > 200
    assert any(g.end_s == 10 for s in DRAWN for g in s.segments)
    ramps = {
        round(g.ramp_s / g.duration_s, 3) for s in DRAWN for g in s.segments if isinstance(g, ImageSegment)
    }
    assert ramps == {0.0, 0.2, 0.5}


def test_severities_go_from_harmless_to_fatal():
    segments = [g for s in DRAWN for g in s.segments]
    covered = [g.transmission for g in segments if g.kind == "covered_lens"]
    assert min(covered) == 0 and max(covered) > 0.5
    drops = [g.share for g in segments if g.kind == "frame_drops"]
    assert max(drops) == 1 and min(drops) < 0.3


@pytest.mark.parametrize("seed", [17])
def test_a_seed_gives_one_scenario_which_survives_being_written(seed, tmp_path):
    assert random_scenario(seed) == random_scenario(seed)
    path = tmp_path / "drawn.yaml"
    path.write_text(dump_yaml(random_scenario(seed)))
    assert load_scenario(path) == random_scenario(seed)
    assert random_scenario(seed) != random_scenario(seed + 1)


def test_random_worlds_fit():
    for s in DRAWN[:20]:
        layout(s.world, s.seed)  # raises where the world's sizes do not fit together
