"""``dslab scenarios``, and the seed with which every command draws."""

import json
import sys

import pytest
from test_families import FAMILY, MEMBERS, write

from experiments import cli
from scenarios.families import library_names
from scenarios.loading import load_scenario
from scenarios.spec import Scenario


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
    assert code == 2 and expected in err and err.count("\n") == 1


def test_the_schema_is_json(dslab):
    _, out, _ = dslab("scenarios", "schema")
    assert "members" in json.loads(out)["properties"]


class _RenderedEnoughError(Exception):
    pass


@pytest.mark.parametrize(
    ("command", "seed"),
    [
        (["render"], None),
        (["render"], 3),
        (["run"], 3),
        (["demo", "--scenario"], 3),
        (["bench"], 3),
        (["export", "--format", "tum"], 3),
    ],
)
def test_commands_draw_with_their_seed(monkeypatch, capsys, tmp_path, command, seed):
    rendered: list[Scenario] = []

    def render_sequence(scenario, *_, **__):
        rendered.append(scenario)
        raise _RenderedEnoughError

    monkeypatch.setattr("sim.sequence_rendering.render_sequence", render_sequence)
    words = [*command, "kitti-like/07", *(["--seed", str(seed)] if seed is not None else [])]
    words += [] if command == ["bench"] else ["--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["dslab", *words])
    with pytest.raises(_RenderedEnoughError):
        cli.main()
    assert rendered == [load_scenario("kitti-like/07", seed)]
    assert rendered[0].seed == (7 if seed is None else 3)
