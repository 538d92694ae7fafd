"""The demonstration leaves its files, replaces only its own, and its table says what happened."""

import io

import pytest
from rich.console import Console
from slam_fakes import fake_factory, make_sequence

from experiments.cli.demo import demo_table
from experiments.demo import run_demo
from scenarios.errors import InputError


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "out"
    sequence = make_sequence()
    summaries = run_demo(sequence, 0, out, build=fake_factory(sequence, breaks_at=160))
    return out, sequence, summaries


def test_both_systems_and_the_picture_are_there(demo):
    out, _, _ = demo
    for kind in ("base", "dual"):
        assert {"recording.rrd", "summary.json", "trajectory.txt"} <= {p.name for p in (out / kind).iterdir()}
    assert (out / "demo.png").read_bytes()[:4] == b"\x89PNG"


def test_a_second_demonstration_replaces_the_first_but_no_other_folder(demo, tmp_path):
    out, sequence, _ = demo
    (out / "dual" / "stale").write_text("")
    run_demo(sequence, 0, out, build=fake_factory(sequence))
    assert not (out / "dual" / "stale").exists()
    (tmp_path / "mine").write_text("")
    with pytest.raises(InputError):
        run_demo(sequence, 0, tmp_path, build=fake_factory(sequence))


def test_the_table_fits_a_terminal_and_tells_base_from_dual(demo):
    _, _, summaries = demo
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(demo_table(summaries, "made-up"))
    lines = console.export_text().splitlines()
    base = next(line for line in lines if line.strip().startswith("base")).split()
    dual = next(line for line in lines if line.strip().startswith("dual")).split()
    assert base[1:6] == ["300", "51.7", "%", "1", "0"]
    assert dual[1:6] == ["300", "91.7", "%", "1", "1"]
    assert sum("low texture 5-6 s" in line for line in lines) == 2
