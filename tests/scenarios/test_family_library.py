"""The families that come with the package."""

from itertools import pairwise

import pytest

from dslab.scenarios.describe_family import describe_parameters
from dslab.scenarios.families import LIBRARY_DIR, family_names, library_names, load_family
from dslab.scenarios.loading import dump_yaml, load_scenario
from dslab.scenarios.spec import Scenario
from dslab.scenarios.worlds import WORLD_KINDS
from dslab.sim.worlds import layout

WANTED = {
    "clean", "kitti-like", "tum-mono-like", "low-texture", "blur", "fast-rotation", "mixed", "slow-start",
    "loop", "aliased",
}  # fmt: skip


def test_every_family_is_there_and_named_like_its_file():
    assert set(library_names()) >= WANTED | {"clean-room", "clean-corridor", "clean-city", "stressed"}
    assert all(load_family(name).name == name for name in (*library_names(), *family_names()))
    assert len(list(LIBRARY_DIR.iterdir())) == len(library_names())
    assert len(load_family("kitti-like").members) == 11
    assert load_family("tum-mono-like").members == tuple(f"{k:02d}" for k in range(1, 51))


def check_draws(names, seeds: int) -> None:
    for name in names:
        family = load_family(name)
        drawn = [family.sample(seed) for seed in range(seeds)]
        different = {s.model_dump_json(exclude={"seed"}) for s in drawn}
        assert len(different) == (len(drawn) if family.parameters else 1), name
        assert family.description
        layout(drawn[-1].world, drawn[-1].seed)  # raises where the world's sizes do not fit together


def test_one_member_of_each_family_draws_valid_and_different_scenarios():
    firsts = {name.split("/")[0]: name for name in reversed(family_names())}
    check_draws(firsts.values(), seeds=4)


@pytest.mark.slow
def test_every_member_draws_valid_and_different_scenarios():
    check_draws(family_names(), seeds=4)


def test_a_sample_of_every_family_survives_writing_and_reading(tmp_path):
    path = tmp_path / "sample.yaml"
    for name in library_names():
        scenario = load_scenario(name, 7)
        path.write_text(dump_yaml(scenario))
        assert load_scenario(path) == scenario


PLAIN = {
    "clean-room": {
        "duration_s": 30,
        "world": {"kind": "room"},
        "trajectory": {"max_speed_mps": 0.9, "max_rate_degps": 40},
        "camera": {"fx_px": 500, "fy_px": 500},
    },
    "clean-corridor": {
        "duration_s": 30,
        "world": {"kind": "corridor", "length_m": 40},
        "trajectory": {"max_speed_mps": 1.0, "max_rate_degps": 40},
        "camera": {"fx_px": 420, "fy_px": 420},
    },
    "clean-city": {
        "duration_s": 40,
        "world": {"kind": "city", "length_m": 400, "turns": 1},
        "trajectory": {"kind": "car"},
        "camera": {"preset": "kitti"},
    },
    "stressed": {
        "duration_s": 30,
        "world": {"kind": "corridor", "length_m": 40, "turns": 2},
        "trajectory": {"max_speed_mps": 1.0, "max_rate_degps": 40, "gaze_deg": 90},
        "camera": {"fx_px": 500, "fy_px": 500},
        "segments": [
            {"kind": "low_texture", "start_s": 6, "duration_s": 2, "contrast": 0.08},
            {"kind": "motion_blur", "start_s": 17, "duration_s": 0.7, "exposure_s": 0.25},
            {"kind": "fast_rotation", "start_s": 22, "duration_s": 1, "rate_degps": 120, "axis": "yaw"},
        ],
    },
}


@pytest.mark.parametrize(("name", "seed"), [*zip(PLAIN, [None, 3, None, 3], strict=True)])
def test_the_plain_scenarios_have_fixed_content(name, seed):
    scenario = load_scenario(name, seed)
    always = {**PLAIN[name], "name": name, "description": scenario.description, "seed": seed or 0}
    assert scenario == Scenario.model_validate(always)


@pytest.mark.parametrize("family", ["low-texture", "blur", "fast-rotation", "mixed"])
def test_clean_time_lies_before_between_and_after_the_segments(family):
    kinds = set()
    whole = load_family(family)
    for seed in range(90 if family == "mixed" else 10):
        scenario = whole.sample(seed)
        segments = scenario.segments
        assert segments[0].start_s >= 8 and scenario.duration_s - segments[-1].end_s >= 10
        assert all(b.start_s - a.end_s >= 6 for a, b in pairwise(segments))
        assert len({s.kind for s in segments}) == len(segments)
        kinds.add(tuple(s.kind for s in segments))
    assert len(kinds) == (15 if family == "mixed" else 1)


def test_aliased_families_have_every_world_and_none_to_two_segments():
    family = load_family("aliased")
    drawn = [family.member(member).sample(seed) for member in family.members for seed in range(14)]
    assert {s.world.kind for s in drawn} == set(WORLD_KINDS)
    assert {len(s.segments) for s in drawn} == {0, 1, 2}
    assert {s.world.aliased.places == 0 for s in drawn} == {True, False}


def test_the_drives_are_those_of_kitti():
    frames = {m: load_scenario(f"kitti-like/{m}").frame_count for m in load_family("kitti-like").members}
    assert {m: n for m, n in frames.items() if m not in ("01", "08")} == {
        "00": 4541, "02": 4661, "03": 801, "04": 271, "05": 2761, "06": 1101, "07": 1101, "09": 1591,
        "10": 1201,
    }  # fmt: skip
    for member in frames:
        scenario = load_scenario(f"kitti-like/{member}")
        assert scenario.camera.fps == 10 and scenario.camera.preset == "kitti"
        assert scenario.trajectory.kind == "car"


def test_the_walks_have_the_camera_of_tum_mono_at_20_to_50_frames():
    drawn = [load_scenario("tum-mono-like", seed) for seed in range(60)]
    assert {s.camera.preset for s in drawn} == {"tum-mono"}
    assert {s.camera.fps for s in drawn} == {20, 25, 30, 40, 50}
    assert {s.world.kind for s in drawn} == {"room", "corridor", "building", "warehouse", "field", "city"}
    assert {s.trajectory.kind for s in drawn} == {"handheld"}


def test_families_are_described_in_words():
    words = describe_parameters(load_family("mixed"))
    assert words["segments"] == "low_texture, motion_blur or fast_rotation"
    assert words["segments.contrast"] == "0.05 to 0.5 (log)"
    assert words["world.turns"] == "1, 2 or 3"
    assert describe_parameters(load_family("stressed")) == {}


def test_the_drives_of_real_are_long_and_their_calibration_is_off():
    for member in ("drive", "city"):
        for seed in range(6):
            scenario = load_scenario(f"real/{member}", seed)
            assert scenario.frame_count >= 800 and scenario.camera.residual.k1 > 0.01
