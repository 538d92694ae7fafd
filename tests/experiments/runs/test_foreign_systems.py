"""A peer system: run in turn on the same frames, judged by the same code; its faults are one line."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from peer_programs import PEER, command
from slam_fakes import FakeSystem, fake_factory, make_sequence

from dslab.experiments.benchmarks.tracker import bench
from dslab.experiments.runs import execution, sources
from dslab.experiments.runs.foreign_systems import open_foreign_system
from dslab.scenarios.errors import InputError
from dslab.sim.io.tum import write_tum

FRAMES = 60


@pytest.fixture
def sequence():
    return make_sequence(FRAMES, segment=None)


@pytest.fixture
def folder(sequence, tmp_path):
    write_tum(sequence, tmp_path / "sequence")
    return tmp_path / "sequence"


WRITE = '(out / "trajectory.txt").write_text("\\n".join(lines))'


def compared(sequence, source, peer_command, runs=2, build=None):
    with open_foreign_system(peer_command, str(source), sequence) as peer:
        return bench(sequence, "base", runs, build=build or fake_factory(sequence, noise_m=0.01), peer=peer)[
            "comparison"
        ]


def test_both_systems_take_turns_and_are_judged_alike(sequence, folder, tmp_path):
    log = tmp_path / "log"

    def build(kind, camera, seed):
        with log.open("a") as file:
            file.write("ours\n")
        return FakeSystem(sequence.T_world_cam, noise_m=0.01)

    found = compared(sequence, folder, command(tmp_path, PEER, "--first=12", log), runs=3, build=build)
    assert log.read_text().split() == ["ours", "peer"] * 3
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


def test_frames_posed_afterwards_do_not_count_as_tracked(sequence, folder, tmp_path):
    """Ours: live poses from frame 5 on, final ones from 3. The peer: 20 live poses, 48 final ones."""

    class Placing(FakeSystem):
        def trajectories(self):
            (path,) = super().trajectories()
            T = np.concatenate([sequence.T_world_cam[3:5], path.T_map_cam])
            frames = np.arange(3, 3 + len(T))
            return [replace(path, frames=frames, stamps_s=sequence.stamps_s[frames], T_map_cam=T)]

    script = PEER.replace("tracked=len(table)", "tracked=20")
    peer_command = command(tmp_path, script, "--first=12", tmp_path / "log")
    found = compared(
        sequence, folder, peer_command, runs=1, build=lambda *_: Placing(sequence.T_world_cam, noise_m=0.01)
    )
    assert found["ours"]["share_tracked"] == pytest.approx((FRAMES - 5) / FRAMES)
    assert found["ours"]["share_with_pose"] == pytest.approx((FRAMES - 3) / FRAMES)
    assert found["peer"]["share_tracked"] == pytest.approx(20 / FRAMES)
    assert found["peer"]["share_with_pose"] == pytest.approx(48 / FRAMES)
    assert found["ratio"]["share_with_pose"] == pytest.approx(57 / 48)


def test_figures_are_medians_over_the_runs(sequence, folder, tmp_path):
    """A peer whose cost differs from run to run: 10, 30, 20 ms."""
    script = PEER.replace(
        "cpu_ms_median=16.0", "cpu_ms_median={1: 10.0, 2: 30.0, 3: 20.0}[len(log.read_text().split())]"
    )
    found = compared(sequence, folder, command(tmp_path, script, "--first=0", tmp_path / "log"), runs=3)
    assert [r["cpu_ms_median"] for r in found["runs"] if r["system"] == "peer"] == [10.0, 30.0, 20.0]
    assert found["peer"]["cpu_ms_median"] == 20.0


def test_another_source_is_written_as_a_tum_folder(sequence, tmp_path):
    found = compared(sequence, "clean-room", command(tmp_path, PEER, "--first=0", tmp_path / "log"), runs=1)
    assert found["peer"]["share_tracked"] == 1.0
    assert found["peer"]["ate_m"] > 0.01


def test_without_truth_there_is_no_ate_and_no_fault(sequence, tmp_path):
    blind = replace(sequence, T_world_cam=None)
    poses = np.column_stack(
        [sequence.stamps_s, sequence.T_world_cam[:, :3, 3], np.tile([0, 0, 0, 1], (FRAMES, 1))]
    )
    np.savetxt(tmp_path / "poses.txt", poses)
    script = PEER.replace('"groundtruth.txt"', repr(str(tmp_path / "poses.txt")))
    with open_foreign_system(command(tmp_path, script, "--first=0", tmp_path / "log"), "x", blind) as peer:
        found = bench(blind, "base", 1, build=fake_factory(sequence), peer=peer)["comparison"]
    assert found["ours"]["ate_m"] is found["peer"]["ate_m"] is found["ratio"]["ate_m"] is None
    assert found["ate_reasons"] == ["no ground truth"]


def test_a_peer_that_tracks_nothing_may_leave_no_trajectory(sequence, folder, tmp_path):
    script = PEER.replace("tracked=len(table)", "tracked=0").replace(", first_tracked_frame=first", "")
    script = script.replace(WRITE, "")
    found = compared(sequence, folder, command(tmp_path, script, "--first=0", tmp_path / "log"), runs=1)
    assert found["peer"] == {
        "cpu_ms_median": 16.0, "ate_m": None, "share_tracked": 0.0, "share_with_pose": 0.0,
        "first_tracked_frame": None,
    }  # fmt: skip
    assert found["ratio"]["share_tracked"] is None and found["ate_reasons"] == ["no map"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("import json", "raise SystemExit(3)\nimport json", "ended with exit code 3: no message"),
        ("import json", "raise OSError('out of luck')\nimport json", "exit code 1: OSError: out of luck"),
        ("import json", "import os\nos.kill(os.getpid(), 9)\nimport json", "exit code -9: no message"),
        ('(out / "summary.json").write_text(json.dumps(summary))', "", "summary.json: the peer has not"),
        ("json.dumps(summary)", "'{'", "summary.json: is no valid JSON"),
        ("json.dumps(summary)", "'[]'", "summary.json: holds no object"),
        ("cpu_ms_median=16.0", "cpu_ms_median='fast'", "summary.json: cpu_ms_median: 'fast' is no number"),
        ("frames=len(stamps)", "frames=7", "summary.json: frames: is 7, the sequence has 60"),
        ("tracked=len(table)", "tracked=61", "summary.json: tracked: 61 is not a whole number up to 60"),
        (WRITE, "", "trajectory.txt: no such file"),
        ("for x in row) for", "for x in row[:7]) for", "trajectory.txt:1: 7 numbers where 8 belong"),
        ("{x:.6f}", "{x + 0.5:.6f}", "trajectory.txt:1: qx qy qz qw"),
        ("row in table]", "row in ([r[0] + 100, *r[1:]] for r in table)]", "stamp: 100.000000 s is"),
    ],
    ids=range(13),
)  # fmt: skip
def test_a_peer_s_faults_are_bad_input(sequence, folder, tmp_path, old, new, says):
    assert old in PEER
    peer_command = command(tmp_path, PEER.replace(old, new), "--first=0", tmp_path / "log")
    with pytest.raises(InputError) as caught:
        compared(sequence, folder, peer_command, runs=1)
    assert says in str(caught.value)


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


def test_there_are_five_runs_by_default_and_the_json_lists_all(dslab, faked, folder, tmp_path):
    peer = command(tmp_path, PEER, "--first=0", tmp_path / "log")
    code, out, _ = dslab("bench", str(folder), "--peer", peer, "--json")
    assert code == 0
    assert len(json.loads(out.splitlines()[-1])["comparison"]["runs"]) == 10


def test_the_table_shows_ours_the_peer_s_and_the_ratio(dslab, faked, folder, tmp_path):
    peer = command(tmp_path, PEER, "--first=0", tmp_path / "log")
    code, out, _ = dslab("bench", str(folder), "--peer", peer, "--runs", "1", "--mode", "threaded")
    assert (code, faked) == (0, ["threaded"])
    (row,) = [line for line in out.splitlines() if "tracking CPU" in line]
    ours = 8 + 0.01 * (FRAMES - 1) / 2
    assert re.split(r" {2,}", row.strip())[1:] == [
        f"{ours:.2f}",
        "16.00",
        f"{ours / 16:.3f}",
    ]
    assert "loop closing, per keyframe" in out and "MiB" in out and "keyframes" in out


@pytest.mark.parametrize(
    ("arguments", "starts"),
    [
        (["--peer", "no-such-program --fast"], "error: --peer: no-such-program: no such command; "),
        (["--peer", "it's"], "error: --peer: it's: is no command line"),
        (["--peer", " "], "error: --peer: is empty; "),
        (["--real-time"], "error: --real-time: the mode is lockstep; add --mode threaded"),
    ],
)
def test_a_wrong_command_is_one_line_and_exit_2(dslab, faked, arguments, starts):
    code, out, err = dslab("bench", "x", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(starts) and err.count("\n") == 1
