"""``dslab scenarios``, and the seed with which every command draws."""

import json
import pickle
import sys

import pytest
from test_families import FAMILY, MEMBERS, write

from dslab.experiments import cli
from dslab.experiments.eq1.spec import PRESET_DIR
from dslab.scenarios.errors import InputError
from dslab.scenarios.families import library_names
from dslab.scenarios.loading import load_scenario
from dslab.scenarios.spec import Scenario


def test_the_full_list_has_every_family_with_members_and_draws(dslab):
    code, out, _ = dslab("scenarios", "list", "--all")
    assert code == 0
    for part in (*library_names(), "kitti-like/10", "segments.contrast: 0.05 to 0.5 (log)"):
        assert part in out


def test_show_gives_the_family_and_with_a_seed_the_sample(dslab, tmp_path):
    _, family, _ = dslab("scenarios", "show", "low-texture/room")
    assert "log_uniform" in family and "&" not in family
    assert load_scenario(write(tmp_path, family), 3) == load_scenario("low-texture/room", 3)
    _, sample, _ = dslab("scenarios", "show", "low-texture/room", "--seed", "3")
    assert "uniform" not in sample
    assert load_scenario(write(tmp_path, sample)) == load_scenario("low-texture/room", 3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name: plain\nworld: {kind: room}\n", "valid, plain, 30 s, 0 segments"),
        (FAMILY, "valid, trial, a family, drawn with 20 seeds"),
        (MEMBERS, "valid, trial, a family, 3 members, drawn with 20 seeds each"),
    ],
)
def test_validate_reports_the_draws(dslab, tmp_path, text, expected):
    code, out, _ = dslab("scenarios", "validate", str(write(tmp_path, text)))
    assert code == 0 and expected in out


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (FAMILY.replace("[20, 40]", "[40, 20]"), ":3: duration_s: uniform from 40 to 20"),
        (FAMILY.replace("[20, 40]", "[5, 40]"), "ends after the sequence, in trial as drawn with seed"),
        (MEMBERS.replace("[0.5, 1]", "[0, 0.5]").replace("0.02", "3"), "in trial/07 as drawn with seed 0"),
    ],
)
def test_validate_finds_faults_of_single_seeds_and_members(dslab, tmp_path, text, expected):
    code, _, err = dslab("scenarios", "validate", str(write(tmp_path, text)))
    assert code == 2 and expected in err
    assert all(line.startswith("error: ") for line in err.splitlines())


BAD = """
name: bad
wrold: {kind: room}
world: {kind: rom, length_m: {uniform: [9, 5]}}
camera: {fps: 20, fps: 30, fx_px: .inf, fy_px: -3, fy: 3}
segments:
  - {kind: jpeg, start_s: 29, duration_s: 2, quality: 9}
  - {kind: jpeg, start_s: 31, duration_s: 4, quality: 9}
members:
  A!: {}
  b: {duration_s: {uniform: [-9, -3]}}
"""


def test_validate_names_every_fault_once_in_the_order_of_the_lines(dslab, tmp_path):
    code, out, err = dslab("scenarios", "validate", write(tmp_path, BAD))
    assert code == 2 and out == ""
    places = [line.split(".yaml:")[1].split(": ")[:2] for line in err.splitlines()]
    assert [int(line) for line, _ in places] == sorted(int(line) for line, _ in places)
    assert {tuple(place) for place in places} == {
        ("3", "wrold"),
        ("4", "world.kind"),
        ("4", "world.length_m"),
        ("5", "camera.fps"),
        ("5", "camera.fx_px"),
        ("5", "camera.fy_px"),
        ("5", "camera.fy"),
        ("10", "members.A!"),
        ("11", "duration_s"),
    }
    assert all(line.startswith("error: ") and "; " in line for line in err.splitlines())


def test_a_name_over_two_lines_makes_no_second_line(dslab, tmp_path):
    text = """
name: "a\\nb"
duration_s: {uniform: [4, 5]}
world: {kind: room}
"""
    code, out, err = dslab("scenarios", "validate", write(tmp_path, text))
    assert (code, out, err.count("\n")) == (2, "", 1) and "name: " in err


def test_validate_names_every_segment_that_does_not_fit(dslab, tmp_path):
    text = "name: bad\nworld: {kind: room}\ncamera: {fy: 3}\nsegments:\n" + "".join(
        f"  - {{kind: jpeg, start_s: {start_s}, duration_s: 3, quality: 9}}\n" for start_s in (28, 1, 2, 29)
    )
    err = dslab("scenarios", "validate", write(tmp_path, text))[2]
    lines = err.splitlines()
    assert [line.split(".yaml:")[1].split(": ")[0] for line in lines] == ["3", "5", "7", "8"]
    assert "end it by duration_s = 30" in lines[1] and "segments[1] (jpeg, 1-4 s)" in lines[2]
    assert load_error(tmp_path / "trial.yaml").endswith("(3 more in this file)")


def load_error(path) -> str:
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    again = pickle.loads(pickle.dumps(caught.value))
    assert list(map(str, again.faults)) == list(map(str, caught.value.faults))
    return str(again)


def test_validate_names_every_fault_of_an_experiment(dslab, tmp_path):
    text = """
name: bad
bases:
  b: {world: {kind: room, wide_m: 3}, camera: {fps: -5}}
  c: {world: {kind: room}, trajectory: {kind: fly}}
degradations:
  - {kind: jpeg, dose: quality, doses: [5, 500]}
worlds: %s
"""
    err = dslab("scenarios", "validate", write(tmp_path, text % 3))[2]
    fields = [line.split(": ")[2] for line in err.splitlines()]
    assert sorted(fields[:2]) == ["bases.b.camera.fps", "bases.b.world.wide_m"]
    assert fields[2:] == ["bases.c.trajectory.kind", "degradations[0].doses[1]"]
    err = dslab("scenarios", "validate", write(tmp_path, (text % 0).replace("bad", "bad name")))[2]
    assert [line.split(": ")[2] for line in err.splitlines()] == ["name", "worlds"]
    code, out, _ = dslab("scenarios", "validate", PRESET_DIR / "smoke.yaml")
    assert code == 0 and "valid, smoke, an experiment, 3 cells of 4 units" in out


def test_the_schema_is_json(dslab):
    _, out, _ = dslab("scenarios", "schema")
    assert "members" in json.loads(out)["properties"]


class _RenderedEnoughError(Exception):
    pass


@pytest.mark.parametrize(
    ("command", "seed"),
    [
        (["export"], None),
        (["run"], 3),
        (["bench"], 3),
        (["export"], 3),
    ],
)
def test_commands_draw_with_their_seed(monkeypatch, capsys, tmp_path, command, seed):
    rendered: list[Scenario] = []

    def render_sequence(scenario, *_, **__):
        rendered.append(scenario)
        raise _RenderedEnoughError

    monkeypatch.setattr("dslab.sim.sequence_rendering.render_sequence", render_sequence)
    words = [*command, "kitti-like/07", *(["--seed", str(seed)] if seed is not None else [])]
    words += [] if command == ["bench"] else ["--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["dslab", *words])
    with pytest.raises(_RenderedEnoughError):
        cli.main()
    assert rendered == [load_scenario("kitti-like/07", seed)]
    assert rendered[0].seed == (7 if seed is None else 3)
