"""Descriptions of scenarios, segments and distributions."""

import pytest

from dslab.scenarios.describe import describe_camera, describe_motion, describe_severity, describe_world
from dslab.scenarios.describe_family import describe_distribution, describe_parameter, parameter_label
from dslab.scenarios.distributions import LogUniform, Uniform, parse_distribution
from dslab.scenarios.families import load_family
from dslab.scenarios.segment_text import parse_segment


def test_severities_have_their_units():
    assert describe_severity(parse_segment("fog:start_s=1,duration_s=2,extinction_per_m=0.5,ramp_s=0.5")) == (
        "ramp 0.5 s, extinction 0.5 /m, airlight level 190"
    )
    assert describe_severity(parse_segment("over_exposure:start_s=1,duration_s=2,stops=3")) == "3 stops"


@pytest.mark.parametrize("name", ["breakage", "kitti-like/01", "loop/city"])
def test_only_what_is_set_is_described(name):
    scenario = load_family(name).sample(1)
    for describe in (describe_world, describe_motion, describe_camera):
        assert "None" not in describe(scenario)


@pytest.mark.parametrize(
    ("place", "node", "words"),
    [
        ("trajectory.max_speed_mps", {"uniform": [1, 2.5]}, "uniform from 1 to 2.5 m/s"),
        ("camera.exposure_s", {"log_uniform": [0.001, 0.1]}, "log-uniform from 0.001 to 0.1 s"),
        ("camera.fps", {"choice": [10, 20]}, "one of: 10 frames/s; 20 frames/s"),
        ("world", {"choice": [{"kind": "room"}, "x"], "weights": [1, 3]}, "one of: room (25 %); x (75 %)"),
        ("segments", {"choice": [[], [{"kind": "fog"}, {"kind": "jpeg"}]]}, "one of: none; fog then jpeg"),
    ],
)  # fmt: skip
def test_distributions_in_words(place, node, words):
    assert describe_parameter(place, parse_distribution(node)) == words


def test_a_drawn_value_is_described_only_within_its_option(tmp_path):
    (tmp_path / "either.yaml").write_text(
        """
name: either
world: {kind: room}
segments:
  choice:
    - [{kind: jpeg, start_s: 1, duration_s: {uniform: [1, 2]}, quality: {uniform: [5, 9]}}]
    - [{kind: fog, start_s: 1, duration_s: {uniform: [3, 4]}, extinction_per_m: {log_uniform: [0.1, 1]}}]
"""
    )
    family = load_family(tmp_path / "either.yaml")
    kinds = set()
    for seed in range(8):
        scenario = family.sample(seed)
        (segment,) = scenario.segments
        described = {
            parameter_label(place, family.written): describe_distribution(
                place, drawn, family.written, scenario
            )
            for place, drawn in family.parameters.items()
            if isinstance(drawn, Uniform | LogUniform)
        }
        own, other = ("jpeg", "fog") if segment.kind == "jpeg" else ("fog", "jpeg")
        assert described[f"segment 1, {own}: duration"] == f"{segment.duration_s:.4g} s"
        assert described[f"segment 1, {other}: duration"] == ""
        kinds.add(segment.kind)
    assert kinds == {"jpeg", "fog"}
