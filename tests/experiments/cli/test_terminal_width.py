"""What the commands print can be read on a terminal of 80 columns: nothing is cut."""

import io
import json
import os
import shutil
from pathlib import Path

import pytest
from rich.console import Console
from typer.main import get_command

from dslab.experiments.campaign.folder import ERRORS_FILE
from dslab.experiments.campaign.runner import SystemTally, Tally
from dslab.experiments.cli import console
from dslab.experiments.cli.commands import app
from dslab.experiments.cli.units import unit_progress
from dslab.scenarios.families import library_names, load_family

PUBLISHED = Path(__file__).resolve().parents[3] / "docs" / "eq1-quick"


@pytest.fixture(autouse=True)
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


def paths(command, path: tuple[str, ...] = ()):
    yield path
    for name, part in getattr(command, "commands", {}).items():
        yield from paths(part, (*path, name))


def fits(text: str) -> bool:
    """Nothing is cut, no line is too long, no markup is left."""
    lines = text.splitlines()
    return "…" not in text and "[/" not in text and max(map(len, lines)) <= 80


def test_no_help_is_cut_or_announces_an_example_without_one(dslab):
    helps = {path: dslab(*path, "-h")[1] for path in paths(get_command(app))}
    assert len(helps) > 30
    assert [path for path, text in helps.items() if not fits(text)] == []
    assert [path for path, text in helps.items() if "example" in text.partition(" Commands ")[2]] == []


def test_the_list_has_one_row_per_family_and_on_request_every_member(dslab):
    families = {name: load_family(name) for name in library_names()}
    _, brief, _ = dslab("scenarios", "list")
    _, full, _ = dslab("scenarios", "list", "--all")
    rows = {line.split()[0]: line.split()[1] for line in brief.splitlines() if line[:1].strip(" ─")}
    assert fits(brief) and fits(full) and len(brief.splitlines()) < 3 * len(families)
    assert {name: rows[name] for name in families} == {
        name: str(len(family.members) or "-") for name, family in families.items()
    }
    assert all(f"{name}/{member}" in full for name, family in families.items() for member in family.members)


def test_the_status_of_a_published_table_is_that_of_its_cells(dslab, tmp_path):
    code, out, _ = dslab("experiment", "status", PUBLISHED)
    assert code == 0 and fits(out) and "fast_rotation/3" in out and "540 of 540 units" in out
    _, as_json, _ = dslab("experiment", "status", PUBLISHED, "--json")
    status = json.loads(as_json)
    assert sum(cell["breakages"] for cell in status["cells"]) == 226 and status["failed_attempts"] == 0
    # The table alone is enough.
    shutil.copytree(PUBLISHED, tmp_path / "p")
    (tmp_path / "p" / ERRORS_FILE).unlink()
    assert dslab("experiment", "status", tmp_path / "p")[1] == out


def test_the_report_prints_its_answer(dslab, monkeypatch, tmp_path):
    measured = {"value": 0.222, "low": 0.141, "high": 0.333}
    row = {"world": "room", "worlds": 9, "n": 2, "eq1": 0.19, "weakest": 0.2, "measured": measured}
    answer = {"headline": "No.", "sentences": ["Asked."], "rows": [row]}

    def write(folder, *_):
        (folder / "report.json").write_text(json.dumps({"answer": answer, "warnings": [], "systems": None}))
        return folder / "report.html"

    monkeypatch.setattr("dslab.experiments.report.write.write_report", write)
    shutil.copytree(PUBLISHED, tmp_path / "p")
    code, out, _ = dslab("experiment", "report", tmp_path / "p")
    assert code == 0 and out.startswith("No.\nAsked.\n") and out.endswith("report.html\n")
    assert "room 9 2 19.0 % 20.0 % 22.2 % 14.1 to 33.3 %" in " ".join(out.split())


def test_progress_shows_count_bar_and_time_left(monkeypatch, tmp_path):
    shown = io.StringIO()
    terminal = Console(file=shown, force_terminal=True, width=80, color_system=None)
    monkeypatch.setattr("dslab.experiments.cli.console.err", terminal)
    with unit_progress("eq1-full", tmp_path) as show:
        show(Tally(1234, 5400, 44, 10, 50, 617, 8, (SystemTally("dual", 1180, 401, 211),)))
    lines = shown.getvalue().splitlines()
    bar = next(line for line in reversed(lines) if "1234/5400" in line)
    assert "━━━━━━" in bar and " left " in bar and "…" not in bar
    assert any("p0 0.34 (401/1180)" in line and "10 errors" in line for line in lines)


RATE = {"frames_per_s": 1234.5, "cpu_ms": 1234.5, "frames_per_s_alone": 1234.5, "peak_rss_mb": 12345}
BENCHMARK = {
    "renderer": "mujoco", "processes": 2, "size_px": [640, 480],
    "asked": {"rendered_per_s": 60, "degraded_per_s": 150, "build_s": 5, "peak_rss_mb": 1536},
    "rendered": {"large_city": RATE}, "degraded": {"sharp": RATE, "blurred": RATE},
    "build": dict.fromkeys(("build_s", "build_cpu_s", "load_s", "peak_rss_mb"), 12345.0),
}  # fmt: skip


def test_the_figures_of_the_simulator_fit(dslab, monkeypatch):
    monkeypatch.setattr("dslab.experiments.benchmarks.simulator.bench_sim", lambda *_: BENCHMARK)
    code, out, _ = dslab("bench", "sim")
    assert code == 0 and fits(out) and "rendered, large city" in out


def test_a_table_has_a_column_per_key_and_figures_stand_right():
    table = console.table_of([{"": "[a]", "n": 3, "what": "word"}, {}, {"": "b", "n": None, "what": "4 m"}])
    assert [c.justify for c in table.columns] == ["left", "right", "left"]
    assert [list(c._cells) for c in table.columns] == [["[a]", "b"], ["3", "-"], ["word", "4 m"]]
    assert table.rows[0].end_section


def test_the_viewer_says_nothing_of_its_own(capfd, monkeypatch, tmp_path):
    from rerun.experimental import ViewerClient

    from dslab.experiments.recording import open_viewer

    def spawn(**_):
        os.write(2, b"Error: winit EventLoopError\n")
        raise RuntimeError("no viewer")

    monkeypatch.setattr(ViewerClient, "spawn", spawn)
    with pytest.raises(ConnectionError):
        open_viewer(tmp_path / "recording.rrd", 0.0)
    assert capfd.readouterr().err == ""
