"""Worlds and motions in scenario files."""

import pytest

from dslab.scenarios.errors import InputError
from dslab.scenarios.loading import dump_yaml, load_scenario
from dslab.scenarios.worlds import WORLD_KINDS, CityWorld

KINDS = list(WORLD_KINDS)
MOTIONS = ("walk", "handheld", "car", "drone")


def test_every_world_and_every_motion_survives_writing_and_reading(tmp_path):
    path = tmp_path / "trial.yaml"
    for k, kind in enumerate(KINDS):
        motion = MOTIONS[k % len(MOTIONS)]
        path.write_text(f"name: trial\nworld: {{kind: {kind}}}\ntrajectory: {{kind: {motion}}}\n")
        scenario = load_scenario(path)
        assert scenario.world.kind == kind and scenario.trajectory.kind == motion
        path.write_text(dump_yaml(scenario))
        assert load_scenario(path) == scenario


def test_the_clean_city_is_driven_with_the_camera_of_kitti():
    scenario = load_scenario("clean-city")
    assert isinstance(scenario.world, CityWorld) and scenario.trajectory.kind == "car"
    assert (scenario.camera.width_px, scenario.camera.height_px, scenario.camera.fps) == (1241, 376, 10)
    assert scenario.trajectory.max_speed_mps == 10 and not scenario.segments


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("world: {kind: city, length_m: 200, loop: true}", ["world", "leaves no block", "280"]),
        ("world: {kind: motorway, length_m: 300, loop: true}", ["world", "too narrow", "480"]),
        ("world: {kind: city, aliased: {places: 1.2}}", ["world.aliased.places", "1.2", "1"]),
        ("world: {kind: field, aliased: {things: -0.1}}", ["world.aliased.things", "-0.1", "0"]),
        ("world: {kind: room, aliased: {likeness: 1}}", ["world.aliased.likeness"]),
        ("world: {kind: room}\ntrajectory: {kind: walk, gust_mps: 2}", ["trajectory", "gust_mps", "drone"]),
        ("world: {kind: room}\ntrajectory: {kind: bus}", ["trajectory.kind", "bus", "car"]),
    ],
)
def test_faults_are_one_line_with_a_remedy(line, expected, tmp_path):
    path = tmp_path / "trial.yaml"
    path.write_text(f"name: trial\n{line}\n")
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    text = str(caught.value)
    assert "\n" not in text
    for part in expected:
        assert part in text
