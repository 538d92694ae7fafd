"""Families: drawing by seed, members, and merging."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from dslab.scenarios.errors import InputError
from dslab.scenarios.families import Family, is_scenario_name, load_family
from dslab.scenarios.loading import dump_yaml, load_scenario

FAMILY = """\
name: trial
description: for the tests
duration_s: {uniform: [20, 40]}
world:
  choice:
    - {kind: room, length_m: {uniform: [8, 14]}}
    - {kind: corridor, length_m: {uniform: [30, 60]}, turns: {uniform: [0, 4]}}
  weights: [1, 3]
trajectory: {kind: {choice: [walk, handheld]}, max_speed_mps: {log_uniform: [0.5, 2]}}
camera:
  choice:
    - {fx_px: {uniform: [400, 600]}}
    - {preset: realsense}
segments:
  - {kind: low_texture, start_s: 4, duration_s: 2, contrast: {log_uniform: [0.05, 0.5]}}
  - choice:
      - {kind: motion_blur, start_s: 8, duration_s: 1, exposure_s: 0.05}
      - {kind: fast_rotation, start_s: 8, duration_s: 1, rate_degps: 90, axis: {choice: [yaw, roll]}}
"""

MEMBERS = """\
name: trial
duration_s: 20
world: {kind: corridor, length_m: {uniform: [30, 60]}, turns: 1}
trajectory: {max_speed_mps: 0.8, sway_m: {uniform: [0, 0.05]}}
members:
  straight: {world: {turns: 0}}
  "07":
    description: another
    world: {kind: room}
    trajectory: {max_speed_mps: {uniform: [0.5, 1]}, sway_m: 0.02}
  as-is:
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "trial.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def family(folder: Path, text: str = FAMILY) -> Family:
    return load_family(write(folder, text))


def samples(folder: Path, text: str = FAMILY, count: int = 20) -> list:
    drawn = family(folder, text)
    return [drawn.sample(seed) for seed in range(count)]


def test_a_seed_gives_one_scenario_and_another_seed_another(tmp_path):
    first, again = samples(tmp_path), samples(tmp_path)
    assert first == again
    assert len({s.model_dump_json(exclude={"seed"}) for s in first}) == len(first)
    assert [s.seed for s in first] == list(range(20))
    assert {s.name for s in first} == {"trial"}


def test_draws_fill_their_bounds(tmp_path):
    drawn = samples(tmp_path, count=200)
    durations = [s.duration_s for s in drawn]
    assert 20 <= min(durations) < 22 and 38 < max(durations) <= 40
    contrasts = [s.segments[0].contrast for s in drawn]
    assert 0.05 <= min(contrasts) < 0.06 and 0.42 < max(contrasts) <= 0.5
    assert {s.trajectory.kind for s in drawn} == {"walk", "handheld"}
    assert {s.segments[1].kind for s in drawn} == {"motion_blur", "fast_rotation"}
    assert {s.camera.preset for s in drawn} == {None, "realsense"}
    rooms = sum(s.world.kind == "room" for s in drawn)
    assert rooms / len(drawn) == pytest.approx(0.25, abs=0.08)


def test_only_drawn_numbers_are_rounded(tmp_path):
    turns = {s.world.turns for s in samples(tmp_path, count=200) if s.world.kind == "corridor"}
    assert turns == {0, 1, 2, 3, 4}
    with pytest.raises(InputError, match=r"world\.turns.*2\.5 is not valid"):
        samples(tmp_path, FAMILY.replace("turns: {uniform: [0, 4]}", "turns: 2.5"))


def test_the_seed_of_the_call_counts_before_the_family_s_own(tmp_path):
    path = write(tmp_path, "seed: 5\n" + FAMILY)
    assert load_family(path).seed == 5
    assert load_scenario(path) == load_scenario(path, 5) == load_family(path).sample(5)
    assert load_scenario(path, 6) != load_scenario(path)


@pytest.mark.parametrize(
    "added",
    [
        ("trajectory: {", "trajectory: {eye_height_m: {uniform: [1, 2]}, "),
        ("start_s: 4,", "start_s: {uniform: [1, 4]},"),
        ("kind: room,", "kind: room, width_m: {uniform: [6, 9]},"),
    ],
)
def test_one_more_distribution_changes_no_other(tmp_path, added):
    def values(text: str) -> list:
        return [
            (
                s.duration_s,
                s.world.kind,
                s.world.length_m,
                s.trajectory.kind,
                s.segments[0].contrast,
                s.camera,
            )
            for s in samples(tmp_path, text)
        ]

    assert FAMILY.count(added[0]) == 1
    assert values(FAMILY.replace(*added)) == values(FAMILY)


def test_fields_are_drawn_independently(tmp_path):
    drawn = samples(tmp_path, count=200)
    columns = np.array(
        [
            [
                s.duration_s,
                np.log(s.segments[0].contrast),
                np.log(s.trajectory.max_speed_mps),
                s.world.kind == "room",
            ]
            for s in drawn
        ]
    )
    correlation = np.corrcoef(columns.T) - np.eye(4)
    assert np.abs(correlation).max() < 0.25


def test_a_choice_of_choices_draws_both(tmp_path):
    text = FAMILY.replace(
        "{choice: [yaw, roll]}", "{choice: [{choice: [yaw, pitch]}, {choice: [roll, pitch]}]}"
    )
    axes = [s.segments[1].axis for s in samples(tmp_path, text, 200) if s.segments[1].kind == "fast_rotation"]
    share = {axis: axes.count(axis) / len(axes) for axis in ("yaw", "pitch", "roll")}
    assert share == pytest.approx({"yaw": 0.25, "pitch": 0.5, "roll": 0.25}, abs=0.12)


def test_the_parameters_are_named_by_their_place(tmp_path):
    names = set(family(tmp_path).parameters)
    assert {"duration_s", "world", "world.choice[0].length_m", "segments[0].contrast", "segments[1]"} <= names
    assert "segments[1].choice[1].axis" in names
    assert len(names) == 12


def test_a_scenario_without_distributions_is_itself_with_any_seed(tmp_path):
    path = write(tmp_path, "name: plain\nworld: {kind: room}\nseed: 2\n")
    assert load_family(path).parameters == {}
    assert load_scenario(path, 9) == load_scenario(path).model_copy(update={"seed": 9})


def test_a_member_overrides_fields_of_its_family(tmp_path):
    whole = family(tmp_path, MEMBERS)
    assert whole.members == ("straight", "07", "as-is")
    straight, room, same = (whole.member(m) for m in whole.members)
    assert [f.name for f in (straight, room, same)] == ["trial/straight", "trial/07", "trial/as-is"]
    assert straight.sample(3).name == "trial/straight"
    # Mappings are merged key by key ...
    assert straight.sample(3).world.turns == 0 and same.sample(3).world.turns == 1
    assert straight.sample(3).world.length_m == same.sample(3).world.length_m != 60
    # ... those of another kind replaced, and a distribution replaces a value and a value a distribution.
    assert room.sample(3).world.model_dump() == {
        "kind": "room", "length_m": 14, "width_m": 10, "height_m": 3.2, "lamp_level": 1.0,
        "surfaces": "worn", "aliased": None,
    }  # fmt: skip
    assert room.sample(3).trajectory.sway_m == 0.02
    assert 0.5 <= room.sample(3).trajectory.max_speed_mps <= 1
    assert set(room.parameters) == {"trajectory.max_speed_mps"}
    assert (room.description, straight.description) == ("another", "")


def test_members_leave_their_family_unchanged(tmp_path):
    whole = family(tmp_path, MEMBERS)
    before = yaml.safe_dump(whole.file.data)
    for member in whole.members:
        whole.member(member).sample(1)
    assert yaml.safe_dump(whole.file.data) == before


def test_the_bare_name_takes_every_member_by_the_seed(tmp_path):
    whole = family(tmp_path, MEMBERS)
    drawn = [whole.sample(seed) for seed in range(20)]
    assert {s.name for s in drawn} == {"trial/straight", "trial/07", "trial/as-is"}
    assert all(s == whole.member(s.name.split("/")[1]).sample(s.seed) for s in drawn)


def test_a_member_of_a_file_is_named_behind_it(tmp_path):
    path = write(tmp_path, MEMBERS)
    assert load_scenario(f"{path}/07", 4) == load_family(path).member("07").sample(4)


def test_a_family_and_a_sample_are_yaml_to_start_from(tmp_path):
    whole = family(tmp_path, MEMBERS)
    room, sample = whole.member("straight"), whole.member("straight").sample(8)
    assert whole.as_yaml() == MEMBERS
    assert family(tmp_path, room.as_yaml()).sample(8) == sample
    assert load_scenario(write(tmp_path, dump_yaml(sample))) == sample


@pytest.mark.parametrize(
    ("text", "is_name"),
    [("stressed", True), ("clean/room", True), ("clean/rom", True), ("a/b.yaml", True), ("a/b.yaml/07", True),
     ("no/such/folder", False), ("room", False)],
)  # fmt: skip
def test_names_of_scenarios_are_distinguished_from_folders(text, is_name):
    assert is_scenario_name(text) is is_name
