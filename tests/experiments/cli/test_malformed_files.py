"""Commands on malformed files and impossible names: exit 2, one line, nothing left."""

import json
import os
from pathlib import Path

import pytest

from dslab.experiments.cli.view import _first_breakage_s
from dslab.experiments.runs.execution import slam_camera
from dslab.scenarios.errors import InputError
from dslab.sim.sensors.camera import Intrinsics

LONG = "a" * 300
SCENARIO = "name: x\nworld: {kind: room}\n"
EXPERIMENT = (Path(__file__).parents[3] / "experiments/eq1/presets/smoke.yaml").read_text()


@pytest.fixture
def refused(dslab, tmp_path, monkeypatch):
    """A function that runs a command, which must end with one line of fault and leave nothing."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)

    def run(*arguments: object) -> str:
        code, _, err = dslab(*arguments)
        assert code == 2 and err.startswith("error: ") and err.count("\n") == 1
        assert list(home.iterdir()) == []
        return err

    return run


@pytest.mark.parametrize(
    "command",
    [
        ["run", LONG, "--out", "o"],
        ["run", f"{LONG}/x", "--out", "o"],
        ["run", f"{LONG}.yaml", "--out", "o"],
        ["run", "clean-room", "--out", LONG],
        ["run", "clean-room", "--out", f"{LONG}/x"],
        ["run", "clean-room", "--config", f"{LONG}.yaml", "--out", "o"],
        ["export", "clean-room", "--out", LONG],
        ["degrade", LONG, "--segment", "jpeg:start_s=0,duration_s=1,quality=8", "--out", "o"],
        ["export", LONG, "--format", "euroc", "--out", "o"],
        ["scenarios", "show", LONG],
        ["scenarios", "validate", LONG],
        ["scenarios", "gallery", "--out", LONG],
        ["view", LONG],
        ["demo", "--out", LONG],
        ["experiment", "status", LONG],
        ["experiment", "report", LONG],
        ["experiment", "export", LONG],
        ["experiment", "run", f"{LONG}.yaml", "--out", "o"],
        ["vocabulary", "train", "--out", f"{LONG}/x.npz"],
    ],
    ids=range(19),
)
def test_a_name_too_long_is_one_line(refused, command):
    refused(*command)


@pytest.mark.parametrize("kind", ["is a pipe", "is a device"])
@pytest.mark.parametrize(
    "command",
    [
        ["run", "FILE", "--out", "o"],
        ["run", "clean-room", "--config", "FILE", "--out", "o"],
        ["scenarios", "validate", "FILE"],
        ["scenarios", "show", "FILE"],
        ["view", "FILE"],
        ["experiment", "run", "FILE", "--out", "o"],
        ["experiment", "status", "FOLDER"],
    ],
    ids=" ".join,
)
def test_a_pipe_or_a_device_is_one_line(refused, tmp_path, command, kind):
    special = tmp_path / "spec.yaml"
    if kind == "is a pipe":
        os.mkfifo(special)
    else:
        special.symlink_to("/dev/zero")
    names = {"FILE": special, "FOLDER": tmp_path}
    assert kind in refused(*(names.get(word, word) for word in command))


@pytest.mark.parametrize("command", [["run"], ["degrade", "--segment", "jpeg"]], ids=" ".join)
def test_a_seed_that_could_not_be_read_back_is_no_option(dslab, tmp_path, command):
    code, _, err = dslab(*command, tmp_path, "--seed", 10**401, "--out", tmp_path / "o")
    assert code == 2 and "--seed" in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_no_place_has_a_zero_byte_in_its_name():
    from dslab.sim.io.folders import check_free

    with pytest.raises(InputError, match="no possible name"):
        check_free(Path("a\0b"))


BAD_YAML = {
    "aliases": (f"x: &a [1]\ny: &b [{'*a, ' * 300}]\nz: [{'*b, ' * 300}]\n", "parts"),
    "recursion": ("x: &a [*a]\n", "stands for a part of itself"),
    "depth": ("x: " + "[" * 400 + "]" * 400 + "\n", "nested more than 40 deep"),
    "twice": ("x: 1\nx: 2\n", "key appears twice"),
    "number": ("x: " + "9" * 401 + "\n", "more than 64 bits"),
}


@pytest.mark.parametrize("fault", BAD_YAML)
@pytest.mark.parametrize("kind", ["scenario", "experiment", "settings"])
def test_every_yaml_file_is_bounded(refused, tmp_path, kind, fault):
    text, expected = BAD_YAML[fault]
    path = tmp_path / "mine.yaml"
    path.write_text({"scenario": SCENARIO, "experiment": EXPERIMENT, "settings": ""}[kind] + text)
    commands = {
        "scenario": ["scenarios", "show", path],
        "experiment": ["experiment", "run", path, "--out", "o"],
        "settings": ["run", "clean-room", "--config", path, "--out", "o"],
    }
    assert expected in refused(*commands[kind])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("worlds: 2", "worlds: 9223372036854775807", "worlds"),
        ("kind: low_texture", "kind: [low_texture]", "kind"),
        ("kind: low_texture", "kind: low_texture\n    acts_s: {choice: [1, {}]}", "acts_s"),
        ("kind: low_texture", "kind: low_texture\n    begins_s: {choice: [[1]]}", "begins_s"),
    ],
)
def test_each_fault_of_an_experiment_is_one_line(refused, tmp_path, old, new, expected):
    assert old in EXPERIMENT
    (tmp_path / "mine.yaml").write_text(EXPERIMENT.replace(old, new, 1))
    line = refused("experiment", "run", tmp_path / "mine.yaml", "--out", "o")
    assert "mine.yaml:" in line and expected in line


@pytest.mark.parametrize("text", ["orb: {n_features: 9000000000}", "initialization: {radius_px: 1.0e+300}"])
def test_settings_beyond_every_sense_are_refused(refused, tmp_path, text):
    (tmp_path / "slam.yaml").write_text(text)
    line = refused("run", "clean-room", "--config", tmp_path / "slam.yaml", "--out", "o")
    assert "is not valid; input should be" in line


def test_a_lens_that_cannot_be_inverted_is_not_valid(refused, tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO + "camera:\n  distortion: {model: radtan, k1: -2}\n")
    for command in (["scenarios", "validate"], ["run", "--out", "o"], ["export", "--out", "o"]):
        line = refused(*command[:2], *command[2:], tmp_path / "mine.yaml")
        assert "mine.yaml:3: camera" in line and "folds the image over itself" in line
    with pytest.raises(InputError, match="cannot be taken out over the whole image"):
        slam_camera(Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, 30.0, (-9.0, 0.0, 0.0, 0.0, 0.0)))


# -- view ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "breakages",
    [3, None, "x", {"stamp_s": 1}, [None], [[1]], [{}], [{"stamp_s": "1"}], [{"stamp_s": True}]],
    ids=range(9),
)
@pytest.mark.parametrize("file", ["summary.json", "base/summary.json"])
def test_a_malformed_list_of_breakages_is_one_line(refused, tmp_path, file, breakages):
    (tmp_path / "recording.rrd").write_text("")
    (tmp_path / "base").mkdir()
    (tmp_path / file).write_text(json.dumps({"breakage_list": breakages}))
    line = refused("view", tmp_path)
    assert file in line and "breakage_list[0]: has no time_s; give --at" in line


@pytest.mark.parametrize("text", ["", "[]", "{", '{"breakage_list": [{"time_s": NaN}]}', "[" * 5000])
def test_a_malformed_summary_is_one_line(refused, tmp_path, text):
    (tmp_path / "recording.rrd").write_text("")
    (tmp_path / "summary.json").write_text(text)
    assert "summary.json" in refused("view", tmp_path)


def test_a_recording_opens_at_the_first_of_all_breakages(tmp_path):
    recording = tmp_path / "recording.rrd"
    recording.write_text("")
    assert _first_breakage_s(recording) == 0.0
    (tmp_path / "summary.json").write_text('{"breakage_list": []}')
    assert _first_breakage_s(recording) == 0.0
    for system, stamps_s in {"base": [5, 2.5], "dual": []}.items():
        (tmp_path / system).mkdir()
        listed = {"breakage_list": [{"time_s": stamp_s} for stamp_s in stamps_s]}
        (tmp_path / system / "summary.json").write_text(json.dumps(listed))
    assert _first_breakage_s(recording) == 2.5
