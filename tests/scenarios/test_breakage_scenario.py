"""The breakage scenario: one short blackout with clean time around it, while the view moves on."""

import math

import pytest

from dslab.scenarios.loading import load_scenario

WALL_M = 1.2
"""Distance from the middle of the corridor to its wall."""


@pytest.fixture
def scenario():
    return load_scenario("breakage", 0)


def test_the_lens_is_covered_once_with_clean_time_before_and_after(scenario):
    (segment,) = scenario.segments
    assert segment.kind == "covered_lens" and segment.transmission == 0
    assert segment.start_s >= 4 and scenario.duration_s - segment.end_s >= 8


def test_the_view_moves_on_by_part_of_its_width(scenario):
    (segment,) = scenario.segments
    view_m = WALL_M * scenario.camera.width_px / scenario.camera.fx_px
    moved_m = scenario.trajectory.max_speed_mps * segment.duration_s
    assert scenario.trajectory.gaze_deg == 90 and scenario.world.width_m == pytest.approx(2 * WALL_M)
    assert 0.35 < moved_m / view_m < 0.65


def test_the_wall_is_straight_where_it_happens(scenario):
    (segment,) = scenario.segments
    leg_m = scenario.world.length_m / (scenario.world.turns + 1)
    latest_m = scenario.trajectory.max_speed_mps * (segment.end_s + 1)
    assert math.ceil(latest_m) <= leg_m
