"""The demonstration writes its files, replaces only its own, and prints what happened in runs and units."""

import time
import urllib.error
import urllib.request
from pathlib import Path

import psutil
import pytest
from pool_fakes import open_local_pool
from rerun.chunk import RrdReader
from slam_fakes import fake_factory, make_sequence
from unit_fakes import made_up_unit

from dslab.experiments.campaign.folder import read_experiment
from dslab.experiments.cli.demo import SCENARIO
from dslab.experiments.cli.run_tables import systems_table
from dslab.experiments.cli.view import view_command
from dslab.experiments.demo import run_demo
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.recording.viewer import served_viewer
from dslab.experiments.statistics.analysis import analyse
from dslab.scenarios.errors import InputError
from dslab.scenarios.loading import load_scenario

DOSES = Path(__file__).parents[3] / "docs" / "eq1-doses"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "out"
    sequence = make_sequence()
    summaries, cells = run_demo(sequence, 0, out, build=fake_factory(sequence, breaks_at=160))
    assert cells == []
    return out, sequence, summaries


def test_each_system_has_a_folder_and_all_share_one_recording_and_picture(demo):
    out, _, _ = demo
    for kind in ("base", "dual+", "ldso"):
        assert {"summary.json", "trajectory.txt"} <= {p.name for p in (out / kind).iterdir()}
    assert (out / "trajectory.png").read_bytes()[:4] == b"\x89PNG"
    entities = {chunk.entity_path for chunk in RrdReader(out / "recording.rrd").stream()}
    assert {
        "/slam/base/tracking",
        "/slam/dual_plus/tracking",
        "/slam/ldso/tracking",
        "/camera/image",
    } <= entities


def test_the_viewer_opens_the_demonstration_at_the_first_breakage(demo, monkeypatch):
    out, _, _ = demo
    opened = []
    monkeypatch.setattr("dslab.experiments.recording.open_viewer", lambda path, at: opened.append((path, at)))
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


def test_the_table_separates_the_systems(demo):
    _, _, summaries = demo
    table = systems_table(summaries)
    rows = [[str(cell) for cell in row] for row in zip(*(c._cells for c in table.columns), strict=True)]
    assert rows[0][:6] == ["base", "51.7 %", "51.7 %", "1", "0", "0"]
    assert rows[2][:6] == ["dual+", "91.7 %", "91.7 %", "1", "1", "0"]
    assert sum("low texture 5-6 s" in row[0] for row in rows) == 3


@pytest.fixture
def made_up_units(monkeypatch):
    """Synthetic units, run in this process."""
    monkeypatch.setattr("dslab.experiments.campaign.workers.open_pool", open_local_pool)
    monkeypatch.setattr("dslab.experiments.eq1.trial.run_unit", made_up_unit)


@pytest.fixture
def demo_command(dslab, made_up_units, no_picture, monkeypatch, tmp_path):
    """`dslab demo` of the fake system and synthetic units, into tmp_path / "d"."""
    sequence = make_sequence(60, segment=(20, 30))
    monkeypatch.setattr("dslab.sim.sequence_rendering.render_sequence", lambda *_, **__: sequence)
    monkeypatch.setattr(
        "dslab.experiments.runs.execution.system_factory", lambda: fake_factory(sequence, breaks_at=25)
    )
    monkeypatch.setenv("COLUMNS", "80")
    return lambda *words: dslab("demo", "--out", tmp_path / "d", *words)


def test_units_follow_with_both_shares_and_their_intervals_and_no_verdict(demo_command, dslab, tmp_path):
    code, out, _ = demo_command()
    assert code == 0 and "…\n" not in out and "None" not in out
    assert max(map(len, out[: out.index("picture ")].splitlines())) <= 80
    spec, table = read_experiment(tmp_path / "d" / "experiment")
    levels = analyse(table, 2).cells
    for level, threads in zip(levels, ("orb ", "orb, sift "), strict=True):
        (row,) = (line for line in out.splitlines() if line.startswith(f"{level.n} ") and threads in line)
        assert f"{100 * level.measured.value:.1f} %" in row and row.count(" to ") == 1
        assert f"{100 * level.eq1:.1f} %" in row
    assert "too few worlds to decide" in " ".join(out.split())
    assert spec.repeats == 1 and table["world_seed"].nunique() == spec.units == len(table)
    assert dslab("experiment", "status", tmp_path / "d" / "experiment")[0] == 0
    assert not list((tmp_path / "d" / "experiment").glob("ledger.sqlite-*"))


def test_the_units_can_be_left_out_and_a_second_demonstration_replaces_the_first(demo_command, tmp_path):
    assert demo_command()[0] == 0
    code, out, _ = demo_command("--no-units")
    assert code == 0 and "Eq. 1" not in out
    assert not (tmp_path / "d" / "experiment").exists() and (tmp_path / "d" / "base").is_dir()


def test_an_interrupted_demonstration_leaves_nothing(demo_command, monkeypatch, tmp_path):
    def interrupted(unit, **_):
        raise KeyboardInterrupt

    monkeypatch.setattr("dslab.experiments.eq1.trial.run_unit", interrupted)
    assert demo_command()[0] == 130
    assert list(tmp_path.iterdir()) == []


def test_units_end_with_systems_that_fail(made_up_units, monkeypatch, tmp_path):
    done = []
    monkeypatch.setattr(
        "dslab.experiments.eq1.trial.run_unit", lambda unit, **_: done.append(unit) or made_up_unit(unit)
    )

    def fails(*_):
        while not done:
            time.sleep(0.01)
        raise ValueError

    many = load_spec("demo").model_copy(update={"worlds": 2_000})
    with pytest.raises(ValueError):
        run_demo(make_sequence(10, segment=None), 0, tmp_path / "d", many, build=fails)
    assert len(done) < many.worlds and list(tmp_path.iterdir()) == []


def test_its_scenario_has_the_three_stresses_one_after_the_other_with_clean_time_around():
    scenario = load_scenario(SCENARIO)
    segments = scenario.segments
    assert [s.kind for s in segments] == ["low_texture", "motion_blur", "fast_rotation"]
    edges_s = [0, *(t for s in segments for t in (s.start_s, s.end_s)), scenario.duration_s]
    assert all(end - start >= 4 for start, end in zip(edges_s[::2], edges_s[1::2], strict=True))


def test_its_units_are_of_the_published_cell_in_which_a_second_thread_adds_most():
    spec, table = read_experiment(DOSES)
    counted = table[(table.outcome == "completed") & (table.exposed == True)]  # noqa: E712
    broke = counted.breakage.eq(True)
    first = broke & counted.free_r1_failed.ne(False)
    both = first & counted.free_r2_failed.ne(False)
    added = (first.astype(float) - both.astype(float)).groupby(counted.cell).mean()
    of = spec.cells[str(added.idxmax())]
    assert of.base is not None and of.degradation is not None and of.dose is not None
    published, shown = spec.degradations[of.degradation], load_spec("demo")
    assert published.kind == shown.degradations[0].kind and published.fields == shown.degradations[0].fields
    assert shown.bases[of.base] == spec.bases[of.base]
    assert shown.degradations[0].doses_of(of.base) == (published.doses_of(of.base)[of.dose],)
    assert (shown.lead_in_s, shown.exposed_s, shown.tail_s) == (spec.lead_in_s, spec.exposed_s, spec.tail_s)


def test_its_rotation_turns_from_frame_to_frame_as_the_published_one_that_breaks_every_corridor():
    (rotation,) = (s for s in load_scenario(SCENARIO).segments if s.kind == "fast_rotation")
    spec, table = read_experiment(DOSES)
    assert table[table.cell == "corridor/fast_rotation/2"].breakage.all()
    (published,) = (d for d in spec.degradations if d.kind == "fast_rotation")
    per_frame = published.doses_of("corridor")[1] / spec.bases["corridor"].camera["fps"]
    assert rotation.rate_degps / load_scenario(SCENARIO).camera.fps == pytest.approx(per_frame)


@pytest.mark.slow
def test_a_browser_of_this_machine_is_served_until_it_ends(demo):
    recording = str(demo[0] / "recording.rrd")
    with served_viewer(Path(recording)) as (address, server):
        assert address.startswith("http://127.0.0.1:")
        until_s = time.monotonic() + 30
        while True:
            try:
                with urllib.request.urlopen(address) as page:
                    assert page.status == 200 and b"<html" in page.read().lower()
                break
            except urllib.error.URLError:
                assert time.monotonic() < until_s and server.poll() is None
                time.sleep(0.1)
    assert server.poll() is not None
    until_s = time.monotonic() + 5
    while any(recording in (p.info["cmdline"] or ()) for p in psutil.process_iter(["cmdline"])):
        assert time.monotonic() < until_s
        time.sleep(0.05)
