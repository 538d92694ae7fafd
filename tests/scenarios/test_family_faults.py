"""Every fault of a family is one line with its place: notation, members, and drawn values."""

import pytest
from test_families import FAMILY, MEMBERS, write

from dslab.scenarios.errors import InputError
from dslab.scenarios.families import load_family


def load_and_sample(name: str, seeds: int) -> None:
    family = load_family(name)
    for seed in range(seeds):
        family.sample(seed)


def fault(folder, text: str, seeds: int = 8, member: str = "") -> str:
    path = write(folder, text)
    with pytest.raises(InputError) as caught:
        load_and_sample(f"{path}/{member}" if member else str(path), seeds)
    line = str(caught.value)
    assert "\n" not in line and line.startswith(str(path))
    return line


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[20, 40]", "[40, 20]", [":3: duration_s:", "from 40 to 20 is empty"]),
        ("[0.05, 0.5]", "[0, 0.5]", [":15: segments[0].contrast:", "logarithm", "start above 0"]),
        ("weights: [1, 3]", "wieghts: [1, 3]", [":4: world:", "wieghts stands beside choice"]),
        ("name: trial", "name: {choice: [a, b]}", [":1: name:", "cannot be drawn"]),
        ("name: trial", "name: trial\nseed: -1", [":2: seed:", "-1 is not valid", "from 0"]),
    ],
)
def test_bad_notation_names_its_place(tmp_path, old, new, expected):
    line = fault(tmp_path, FAMILY.replace(old, new, 1), seeds=0)
    for part in expected:
        assert part in line


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        # The line is that of the drawn option, the field that of the scenario.
        ("[30, 60]", "[3, 7]", [":7: world.length_m:", "is not valid, in trial as drawn with seed", "to 8"]),
        ("kind: room,", "kind: room, wide_m: 4,", [":6: world.wide_m:", "unknown key", "width_m"]),
        ("exposure_s: 0.05", "exposure: 0.05", [":17: segments[1].exposure", "unknown key", "exposure_s"]),
        ("start_s: 4", "start_s: {uniform: [39.5, 60]}", ["ends after the sequence", "drawn with seed 0"]),
    ],
)  # fmt: skip
def test_an_invalid_sample_names_family_seed_and_field(tmp_path, old, new, expected):
    assert old in FAMILY
    line = fault(tmp_path, FAMILY.replace(old, new, 1))
    for part in expected:
        assert part in line


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"07"', "07", [":5: members: has an id that is no text, 7", 'example "00"']),
        ("straight", "Straight Ahead", [":6: members.Straight Ahead", "is no id"]),
        ("description: another", "name: another", [":8: members.07.name", "given by the member's id"]),
    ],
)
def test_bad_members_are_reported(tmp_path, old, new, expected):
    line = fault(tmp_path, MEMBERS.replace(old, new, 1), seeds=0)
    for part in expected:
        assert part in line


def test_members_without_content_are_reported(tmp_path):
    head = MEMBERS.split("members:")[0]
    for members in ("members:", "members: []", "members: {}"):
        assert ":5: members: holds no members" in fault(tmp_path, head + members + "\n", seeds=0)


def test_a_fault_of_a_member_names_its_line(tmp_path):
    own = fault(tmp_path, MEMBERS.replace("turns: 0", "turns: -1"), member="straight")
    assert ":6: world.turns:" in own and "trial/straight" in own
    inherited = fault(tmp_path, MEMBERS.replace("[30, 60]", "[3, 7]"), member="straight")
    assert ":3: world.length_m:" in inherited and "trial/straight as drawn with seed 0" in inherited
    notation = fault(tmp_path, MEMBERS.replace("[0.5, 1]", "[1, 0.5]"), member="07")
    assert ":10: trajectory.max_speed_mps: uniform from 1 to 0.5" in notation


def test_a_fault_in_a_yaml_merge_is_found(tmp_path):
    text = MEMBERS.replace(
        "  straight:", "  long: &long {world: {length_m: 5}}\n  late: {<<: *long, duration_s: 9}\n  straight:"
    )
    assert ":6: world.length_m:" in fault(tmp_path, text, member="late")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("clean/rom", ["clean/rom: clean has no such member", "use room (did you mean that?)", "corridor"]),
        ("stressed/00", ["stressed has no such member", "leave it out"]),
        ("cleen/room", ["cleen/room: no such scenario", "clean/room (did you mean that?)"]),
    ],
)
def test_unknown_names_come_with_a_guess(name, expected):
    with pytest.raises(InputError) as caught:
        load_family(name)
    for part in expected:
        assert part in str(caught.value)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_out_of_range_is_refused(seed):
    with pytest.raises(InputError, match=f"seed {seed}: is out of range"):
        load_family("stressed").sample(seed)
