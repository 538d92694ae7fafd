"""The demonstration writes its files, replaces only its own, and prints a table."""

import io

import pytest
from rerun.chunk import RrdReader
from rich.console import Console
from slam_fakes import fake_factory, make_sequence

from experiments.cli.demo import demo_table
from experiments.cli.view import view_command
from experiments.demo import run_demo
from scenarios.errors import InputError


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "out"
    sequence = make_sequence()
    summaries = run_demo(sequence, 0, out, build=fake_factory(sequence, breaks_at=160))
    return out, sequence, summaries


def test_each_system_has_a_folder_and_all_share_one_recording_and_picture(demo):
    out, _, _ = demo
    for kind in ("base", "dual+"):
        assert {"summary.json", "trajectory.txt"} <= {p.name for p in (out / kind).iterdir()}
    assert (out / "demo.png").read_bytes()[:4] == b"\x89PNG"
    entities = {chunk.entity_path for chunk in RrdReader(out / "recording.rrd").stream()}
    assert {"/lanes/base/state", "/lanes/dual\\+/state", "/camera/image"} <= entities


def test_the_viewer_opens_the_demonstration_at_the_first_breakage(demo, monkeypatch):
    out, _, _ = demo
    opened = []
    monkeypatch.setattr("experiments.recording.open_viewer", lambda path, at: opened.append((path, at)))
    view_command(out)
    assert opened == [(out / "recording.rrd", pytest.approx(160 / 30))]


def test_a_demonstration_of_any_systems_replaces_an_earlier_one_but_no_other_folder(tmp_path):
    sequence, out = make_sequence(30, segment=None), tmp_path / "out"
    for _ in range(2):
        made = run_demo(sequence, 0, out, build=fake_factory(sequence), systems=["dual"])
        assert list(made) == ["dual"] and (out / "demo.png").is_file()
        assert not (out / "dual" / "stale").exists()
        (out / "dual" / "stale").write_text("")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious").write_text("")
    with pytest.raises(InputError):
        run_demo(sequence, 0, tmp_path / "mine", build=fake_factory(sequence))


def test_the_table_fits_a_terminal_and_separates_base_from_dual(demo):
    _, _, summaries = demo
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(demo_table(summaries, "made-up"))
    lines = console.export_text().splitlines()
    base = next(line for line in lines if line.strip().startswith("base")).split()
    dual = next(line for line in lines if line.strip().startswith("dual")).split()
    assert base[1:8] == ["51.7", "%", "51.7", "%", "1", "0", "0"]
    assert dual[1:8] == ["91.7", "%", "91.7", "%", "1", "1", "0"]
    assert sum("low texture 5-6 s" in line for line in lines) == 2
