"""Another system beside ours: run in turn on the same frames, judged by the same code."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from slam_fakes import FakeSystem, fake_factory, make_sequence
from system_programs import program, write_program

from dslab.experiments.benchmarks.tracker import bench
from dslab.experiments.runs import execution, sources
from dslab.experiments.runs.systems.run import ended_well, run_system

FRAMES = 60
FILES = {"frames": "frames.csv", "live": "live.txt"}
# Its last 48 frames with noise, at 16 ms of CPU; EDIT is done before it writes.
PEER = """
import random
noise = random.Random(0)
rows = [[r[0], *(str(float(x) + noise.gauss(0, 0.02)) for x in r[1:4]), *r[4:]] for r in rows[12:]]
live, cpu_ms, lines = rows, 16.0, []
EDIT
with (pathlib.Path(__file__).parent / "log").open("a") as file:
    file.write("peer\\n")
(out / "frames.csv").write_text("stamp_s,cpu_ms\\n" + "".join(f"{s},{cpu_ms}\\n" for s in stamps))
(out / "live.txt").write_text("".join(" ".join(row) + "\\n" for row in live))
"""


@pytest.fixture
def sequence():
    return make_sequence(FRAMES, segment=None)


def compared(sequence, folder, edit="", runs=2, build=None):
    system = program(folder, sequence, PEER.replace("EDIT", edit), **FILES)
    peer = lambda: ended_well(run_system(system, sequence, 0))  # noqa: E731
    build = build or fake_factory(sequence, noise_m=0.01)
    return bench(sequence, "base", runs, build=build, peer=peer)["comparison"]


def test_both_systems_take_turns_and_are_judged_alike(sequence, tmp_path):
    def build(kind, camera, seed):
        with (tmp_path / "log").open("a") as file:
            file.write("ours\n")
        return FakeSystem(sequence.T_world_cam, noise_m=0.01)

    found = compared(sequence, tmp_path, runs=3, build=build)
    assert (tmp_path / "log").read_text().split() == ["ours", "peer"] * 3
    assert [(r["run"], r["system"]) for r in found["runs"]] == [
        (n, who) for n in range(3) for who in ("ours", "peer")
    ]
    # CPU of the fake: 8 ms + 0.01 ms per frame.
    assert found["ours"]["cpu_ms_median"] == pytest.approx(8 + 0.01 * (FRAMES - 1) / 2)
    assert found["ratio"]["cpu_ms_median"] == pytest.approx(found["ours"]["cpu_ms_median"] / 16.0)
    assert (found["ours"]["first_tracked_frame"], found["peer"]["first_tracked_frame"]) == (5, 12)
    assert found["ratio"]["share_tracked"] == pytest.approx((FRAMES - 5) / (FRAMES - 12))
    # Noise of 0.01 m at the truth's scale, and of 0.02 at half of it: 0.04 m, minus what alignment absorbs.
    assert found["ours"]["ate_m"] == pytest.approx(np.sqrt(3) * 0.01, rel=0.25)
    assert found["peer"]["ate_m"] == pytest.approx(np.sqrt(3) * 0.04, rel=0.25)
    assert found["ratio"]["ate_m"] == pytest.approx(found["ours"]["ate_m"] / found["peer"]["ate_m"])


def test_frames_posed_afterwards_do_not_count_as_tracked(sequence, tmp_path):
    """Ours: live poses from frame 5 on, final ones from 3. The peer: 20 live poses, 48 final ones."""

    class Placing(FakeSystem):
        def trajectories(self):
            (path,) = super().trajectories()
            T = np.concatenate([sequence.T_world_cam[3:5], path.T_map_cam])
            frames = np.arange(3, 3 + len(T))
            return [replace(path, frames=frames, stamps_s=sequence.stamps_s[frames], T_map_cam=T)]

    build = lambda *_: Placing(sequence.T_world_cam, noise_m=0.01)  # noqa: E731
    found = compared(sequence, tmp_path, "live = rows[:20]", runs=1, build=build)
    assert found["ours"]["share_tracked"] == pytest.approx((FRAMES - 5) / FRAMES)
    assert found["ours"]["share_with_pose"] == pytest.approx((FRAMES - 3) / FRAMES)
    assert found["peer"]["share_tracked"] == pytest.approx(20 / FRAMES)
    assert found["peer"]["share_with_pose"] == pytest.approx(48 / FRAMES)
    assert found["ratio"]["share_with_pose"] == pytest.approx(57 / 48)


def test_figures_are_medians_over_the_runs(sequence, tmp_path):
    """A peer whose cost differs from run to run: 10, 30, 20 ms."""
    (tmp_path / "log").touch()
    edit = "cpu_ms = [10.0, 30.0, 20.0][len(pathlib.Path(__file__).with_name('log').read_text().split())]"
    found = compared(sequence, tmp_path, edit, runs=3)
    assert [r["cpu_ms_median"] for r in found["runs"] if r["system"] == "peer"] == [10.0, 30.0, 20.0]
    assert found["peer"]["cpu_ms_median"] == 20.0


def test_without_truth_there_is_no_ate_and_no_fault(sequence, tmp_path):
    system = program(tmp_path, sequence, PEER.replace("EDIT", ""), **FILES)
    blind = replace(sequence, T_world_cam=None)
    build = fake_factory(sequence)
    found = bench(blind, "base", 1, build=build, peer=lambda: run_system(system, blind, 0))["comparison"]
    assert found["ours"]["ate_m"] is found["peer"]["ate_m"] is found["ratio"]["ate_m"] is None
    assert found["ate_reasons"] == ["no ground truth"]


def test_a_peer_may_track_nothing_and_say_nothing_of_its_cost(sequence, tmp_path):
    found = compared(sequence, tmp_path, "rows = live = []\ncpu_ms = ''", runs=1)
    assert found["peer"] == {
        "cpu_ms_median": None, "ate_m": None, "share_tracked": 0.0, "share_with_pose": 0.0,
        "first_tracked_frame": None,
    }  # fmt: skip
    assert found["ratio"]["share_tracked"] is None and found["ate_reasons"] == ["no map"]


# -- the command line ----------------------------------------------------------------------------------------


@pytest.fixture
def faked(monkeypatch, sequence):
    modes = []

    def factory(mode="lockstep", dual=None):
        modes.append(mode)
        return fake_factory(sequence)

    monkeypatch.setattr("dslab.slam.warmup.warm_up", lambda progress: None)
    monkeypatch.setattr(sources, "open_sequence", lambda source, seed, show, **options: sequence)
    monkeypatch.setattr(execution, "system_factory", factory)
    return modes


@pytest.fixture
def peer(sequence, tmp_path):
    """Options that name it."""
    write_program(tmp_path, sequence, PEER.replace("EDIT", ""), **FILES)
    return "--peer", "copy", "--systems", tmp_path


def test_there_are_five_runs_by_default_and_the_json_lists_all(dslab, faked, peer):
    code, out, _ = dslab("bench", "x", *peer, "--json")
    assert code == 0
    assert len(json.loads(out.splitlines()[-1])["comparison"]["runs"]) == 10


def test_the_table_shows_ours_the_peer_s_and_the_ratio(dslab, faked, peer):
    code, out, _ = dslab("bench", "x", *peer, "--runs", "1", "--mode", "threaded")
    assert (code, faked) == (0, ["threaded"])
    (row,) = [line for line in out.splitlines() if "tracking CPU" in line]
    ours = 8 + 0.01 * (FRAMES - 1) / 2
    assert re.split(r" {2,}", row.strip())[1:] == [f"{ours:.2f}", "16.00", f"{ours / 16:.3f}"]
    assert "loop closing, per keyframe" in out and "MiB" in out and "keyframes" in out


def test_a_peer_that_does_not_end_well_is_one_line(dslab, faked, sequence, tmp_path):
    write_program(tmp_path, sequence, "raise OSError('out of luck')")
    code, _, err = dslab("bench", "x", "--peer", "copy", "--systems", tmp_path)
    assert code == 2 and err.startswith(
        "error: system copy: crashed: ended with exit code 1: OSError: out of"
    )


@pytest.mark.parametrize(
    ("arguments", "starts"),
    [
        (["--peer", "no-such"], "error: --system: there is no system 'no-such'; "),
        (["--peer", "svo"], "error: system svo: svo-cpp==1.5.0 is not installed"),
        (["--real-time"], "error: --real-time: the mode is lockstep; add --mode threaded"),
    ],
)
def test_a_wrong_command_is_one_line_and_exit_2(dslab, faked, monkeypatch, tmp_path, arguments, starts):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path))
    code, out, err = dslab("bench", "x", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(starts) and err.count("\n") == 1
