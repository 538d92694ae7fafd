"""The demonstration writes its files, replaces only its own, and prints a table."""

import pytest
from rerun.chunk import RrdReader
from slam_fakes import fake_factory, make_sequence

from experiments.cli.run_tables import systems_table
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
    assert (out / "trajectory.png").read_bytes()[:4] == b"\x89PNG"
    entities = {chunk.entity_path for chunk in RrdReader(out / "recording.rrd").stream()}
    assert {"/lanes/base/state", "/lanes/dual\\+/state", "/camera/image"} <= entities


def test_the_viewer_opens_the_demonstration_at_the_first_breakage(demo, monkeypatch):
    out, _, _ = demo
    opened = []
    monkeypatch.setattr("experiments.recording.open_viewer", lambda path, at: opened.append((path, at)))
    view_command(out)
    assert opened == [(out / "recording.rrd", pytest.approx(160 / 30))]


def test_a_demonstration_replaces_an_earlier_one_but_no_other_folder(tmp_path, no_picture):
    sequence, out = make_sequence(30, segment=None), tmp_path / "out"
    for _ in range(2):
        run_demo(sequence, 0, out, build=fake_factory(sequence))
        assert (out / "demo.json").is_file() and not (out / "base" / "stale").exists()
        (out / "base" / "stale").write_text("")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious").write_text("")
    with pytest.raises(InputError):
        run_demo(sequence, 0, tmp_path / "mine", build=fake_factory(sequence))


def test_the_table_separates_base_from_dual(demo):
    _, _, summaries = demo
    table = systems_table(summaries)
    rows = [[str(cell) for cell in row] for row in zip(*(c._cells for c in table.columns), strict=True)]
    assert rows[0][:6] == ["base", "51.7 %", "51.7 %", "1", "0", "0"]
    assert rows[2][:6] == ["dual+", "91.7 %", "91.7 %", "1", "1", "0"]
    assert sum("low texture 5-6 s" in row[0] for row in rows) == 2
