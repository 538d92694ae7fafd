"""A program as a system: what it is given, what becomes of its files, and every way in which it can end."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from slam_fakes import make_sequence
from system_programs import program, write_program

from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs import sources
from dslab.experiments.runs.ending import Declares, EndKind
from dslab.experiments.runs.systems import guarded
from dslab.experiments.runs.systems.command import LOG_FILE, run_command
from dslab.experiments.runs.systems.command_spec import read_command_spec
from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.forms import load_sequence
from dslab.sim.io.tum import write_tum
from dslab.sim.unfinished import sweep_scratch

FRAMES = 40


@pytest.fixture
def sequence():
    return make_sequence(FRAMES, segment=None)


@pytest.fixture
def run(tmp_path, sequence):
    """Runs the copying program after an edit of what it does."""

    def run(edit="pass", of=sequence, **fields):
        system = program(tmp_path / "systems", sequence, edit, **fields)
        return run_command(system, of, 3, tmp_path)

    return run


def test_its_poses_are_judged_as_ours(run):
    record = run()
    summary = summarise(record)
    assert summary["ate_m"] == pytest.approx(0.0, abs=1e-6) and summary["ate_poses"] == FRAMES
    assert summary["scale_m_per_map_unit"] == pytest.approx(2.0)
    assert (summary["ended"], summary["declares"], summary["live_poses"]) == ("finished", "nothing", "final")
    assert summary["config"]["command"].endswith("{out}") and summary["peak_rss_mb"] > 1


def test_it_is_given_frames_and_camera_and_no_truth(run, tmp_path):
    run(f"import shutil; shutil.copytree(seq, {str(tmp_path / 'seen')!r})")
    files = {path.name: path for path in (tmp_path / "seen").iterdir()}
    assert set(files) == {"camera.yaml", "rgb", "rgb.txt", "meta.json", "orbslam3.yaml", "segments.json"}
    assert json.loads(files["segments.json"].read_text()) == [] and len(files["meta.json"].read_text()) < 40


def test_a_damaged_image_is_left_out_and_counted(run, tmp_path, sequence):
    write_tum(sequence, tmp_path / "own")
    (tmp_path / "own" / "rgb" / "000020.png").write_bytes(b"no image")
    with pytest.warns(InputNotice, match="000020.png.*1 frames that cannot be read are left out"):
        record = run(of=load_sequence(tmp_path / "own"))
    assert record.unreadable_frames == 1 and len(record.results) == FRAMES - 1
    assert record.ending.kind is EndKind.FINISHED


def test_what_it_does_to_its_frames_reaches_no_other_run(run, tmp_path, sequence):
    write_tum(sequence, tmp_path / "own")
    before = {path: path.read_bytes() for path in (tmp_path / "own").rglob("*") if path.is_file()}
    opened = load_sequence(tmp_path / "own")
    spoil = "[path.write_bytes(b'') for path in seq.rglob('*') if path.is_file()]"
    for edit in (spoil, "import cv2; assert cv2.imread(str(seq / 'rgb/000000.png')) is not None"):
        record = run(edit, of=opened)
        assert record.ending.kind is EndKind.FINISHED and len(record.trajectories[0].frames) == FRAMES
    assert {path: path.read_bytes() for path in before} == before and np.array_equal(
        opened.frames[0], sequence.frames[0]
    )


@pytest.mark.parametrize("form", ["kitti", "euroc"])
def test_other_forms_are_read_and_written(run, form):
    fields = {"reads": form, "trajectory_form": form}
    edit = f"""
if {form!r} == "kitti":
    import numpy as np
    from scipy.spatial.transform import Rotation
    rows = []
    for p in poses:
        R, t = Rotation.from_quat([float(x) for x in p[4:]]).as_matrix(), np.array(p[1:4], float) / 2
        rows.append([str(x) for x in np.column_stack([R, t]).ravel()])
else:
    table = (seq / "mav0/cam0/data.csv").read_text().splitlines()[1:]
    rows = [[",".join([line.split(",")[0], *p[1:4], p[7], *p[4:7]])] for line, p in zip(table, poses)]
"""
    record = run(edit, **fields)
    assert record.ending.kind is EndKind.FINISHED, record.ending
    assert summarise(record)["ate_m"] == pytest.approx(0.0, abs=1e-6)
    assert len(record.trajectories[0].frames) == FRAMES


def test_what_it_says_of_frames_becomes_times_and_losses(run):
    edit = """
states = ["OK"] * 10 + ["LOST"] * 5 + ["OK"] * 25
lines = [f"{s},{state},2.5,1.5" for s, state in zip(stamps, states)]
(out / "frames.csv").write_text("stamp_s,state,ms,cpu_ms\\n" + "\\n".join(lines))
rows = [row for row, state in zip(rows, states) if state == "OK"]
(out / "live.txt").write_text("".join(" ".join(row) + "\\n" for row in rows[:20]))
"""
    record = run(edit, frames="frames.csv", live="live.txt", lost_states="[LOST]")
    (event,) = record.events
    assert (event.frame, event.reason) == (10, "lost") and record.declares is Declares.LOSSES
    summary = summarise(record)
    assert (summary["cpu_ms_median"], summary["ms_median"]) == (1.5, 2.5)
    assert (summary["tracked"], summary["posed"], summary["live_poses"]) == (20, 35, "given")
    assert record.results[12].reason == "LOST"
    assert {r.map_id for r in record.results} == {0}, "the final poses go on behind the loss"


def test_poses_behind_a_loss_are_of_another_map_where_the_final_ones_are_not(run):
    edit = """
states = ["OK"] * 20 + ["LOST"] * 5 + ["OK"] * 15
(out / "frames.csv").write_text("stamp_s,state\\n" + "\\n".join(f"{s},{w}" for s, w in zip(stamps, states)))
(out / "live.txt").write_text("".join(" ".join(r) + "\\n" for r, w in zip(rows, states) if w == "OK"))
rows = rows[:20]
"""
    record = run(edit, frames="frames.csv", live="live.txt", lost_states="[LOST]")
    assert {m: len(path.frames) for m, path in record.live.items()} == {0: 20, 1: 15}


@pytest.mark.parametrize("figures", ["2.5,-1.5,0", "-0.1,1,0", "nan,1,0", "1,1e300,0", "1,1,-1"])
def test_figures_of_frames_that_are_none_are_an_outcome_and_reach_no_result(run, figures):
    edit = f"""
lines = [f"{{s}},2.5,1.5,0" for s in stamps]
lines[7] = f"{{stamps[7]}},{figures}"
(out / "frames.csv").write_text("stamp_s,ms,cpu_ms,map_id\\n" + "\\n".join(lines))
"""
    record = run(edit, frames="frames.csv")
    assert record.ending.kind is EndKind.UNREADABLE and "not from 0 to 1e+09" in record.ending.message
    assert not any(r.cpu_ms or r.ms for r in record.results) and len(record.trajectories[0].frames) == FRAMES


MAPS = """
name = "trajectory_7.txt"
(out / "trajectory_12.txt").write_text("".join(" ".join(row) + "\\n" for row in rows[:25]))
(out / "trajectory_x.txt").write_text("of no map")
(out / "keyframes_7.txt").write_text(" ".join(rows[30]) + "\\n")
(out / "keyframes_12.txt").write_text("".join(" ".join(row) + "\\n" for row in rows[:2]))
(out / "live.txt").write_text("".join(" ".join(row) + "\\n" for row in rows))
maps = [12] * 25 + [7] * 15
lines = [f"{s},OK,2,1,{map_id},8,9" for s, map_id in zip(stamps, maps)]
lines.insert(0, "stamp_s,state,ms,cpu_ms,map_id,mapping_cpu_ms,loop_cpu_ms")
(out / "frames.csv").write_text("\\n".join(lines))
rows = rows[25:]
told = [dict(event="breakage", frame=25, stamp_s=float(stamps[25]), map_id=12, reason="dark", inliers=3)]
told.append(dict(event="of a later release", frame=25))
"""
LOOP = """
import numpy as np
from scipy.spatial.transform import Rotation
def side(frames):
    T = np.tile(np.eye(4), (len(frames), 1, 1))
    for of, p in zip(T, (np.array(poses[frame], float) for frame in frames)):
        of[:3, :3], of[:3, 3] = Rotation.from_quat(p[4:]).as_matrix(), p[1:4]
    return dict(frames=frames, stamps_s=[float(stamps[f]) for f in frames], T_map_cam=T.tolist())
told.append(dict(event="loop_closed", frame=39, stamp_s=float(stamps[39]), map_id=7, keyframe=39,
                 loop_keyframe=2, scale=1, matches=50, cpu_ms=1.5,
                 relation=dict(old=side([*range(24)]), new=side([*range(25, 40)]), depth=0.5)))
"""
TOLD = """
(out / "events.jsonl").write_text("".join(json.dumps(row) + "\\n" for row in told))
"""
SEVERAL = {"trajectory": "trajectory_*.txt", "keyframes": "keyframes_*.txt", "live": "live.txt",
           "frames": "frames.csv", "events": "events.jsonl"}  # fmt: skip


def test_several_maps_and_events_are_judged_as_ours(run):
    record = run(MAPS + LOOP + TOLD, **SEVERAL)
    assert record.ending.kind is EndKind.FINISHED, record.ending
    assert [(t.map_id, len(t.frames)) for t in record.trajectories] == [(12, 25), (7, 15)]
    assert [(t.map_id, len(t.frames)) for t in record.keyframes] == [(12, 2), (7, 1)]
    assert {m: len(path.frames) for m, path in record.live.items()} == {12: 25, 7: 15}
    assert [event.kind for event in record.events] == ["breakage", "loop_closed"]
    summary = summarise(record)
    assert (summary["maps"], summary["breakages"], summary["declares"]) == (2, 1, "events")
    assert (summary["mapping_cpu_ms_median"], summary["loop_cpu_ms_median"]) == (8, 9)
    (loop,) = summary["audit"]["loops"]
    assert loop["false"] is False, loop


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        ("told[0]['frame'] = 40", "is of no frame from 0 to 39"),
        ("told[0]['inliers'] = 'many'", "inliers: 'many'"),
        ("del told[0]['reason']", "reason"),
        ("told[0] = [1]", "is no event"),
        ("told[-1]['relation']['new']['frames'] = [0, 99]", "is of no frame"),
        ("told[-1]['relation']['old']['T_map_cam'] = [1]", "cannot reshape"),
    ],
    ids=range(6),
)
def test_events_that_are_none_are_an_outcome(run, edit, says):
    record = run(MAPS + LOOP + edit + TOLD, **SEVERAL)
    assert record.ending.kind is EndKind.UNREADABLE and says in record.ending.message
    assert record.events == () and len(record.trajectories) == 2


@pytest.mark.parametrize(
    ("edit", "kind", "says", "posed"),
    [
        ("raise SystemExit(3)", EndKind.CRASHED, "exit code 3: no message", 0),
        ("raise OSError('out of luck')", EndKind.CRASHED, "OSError: out of luck", 0),
        ("import os; os.kill(os.getpid(), 11)", EndKind.CRASHED, "SIGSEGV", 0),
        ("time.sleep(100)", EndKind.TIMED_OUT, "not done after 2 s", 0),
        ("x = bytearray(400 * 2**20)\ntime.sleep(100)", EndKind.OUT_OF_MEMORY, "more than 300 MiB", 0),
        ("raise MemoryError('enough')", EndKind.OUT_OF_MEMORY, "MemoryError", 0),
        ("rows[5][2] = 'nan'", EndKind.NOT_FINITE, "row 6: the pose is not finite", FRAMES - 1),
        ("rows[5][5] = 'inf'", EndKind.NOT_FINITE, "row 6", FRAMES - 1),
        ("rows[5][2] = '?'", EndKind.UNREADABLE, "are no numbers", 0),
        ("rows[5] = rows[5][:7]", EndKind.UNREADABLE, "trajectory.txt:6: 7 numbers where 8 belong", 0),
        ("rows[5][4:] = ['3'] * 4", EndKind.UNREADABLE, "row 6: is no pose", 0),
        ("rows[5][0] = '77.5'", EndKind.OTHER_STAMPS, "77.500000 s is the time of no frame", 0),
        ("rows[5][0] = 'nan'", EndKind.OTHER_STAMPS, "row 6", 0),
        ("(out / name).write_bytes(bytes(range(256))); raise SystemExit(0)", EndKind.UNREADABLE, "UTF-8", 0),
        ("name = 'elsewhere.txt'", EndKind.FINISHED, "", 0),
        ("(out / name).write_text(' '.join(rows[0]) + '\\n'); raise SystemExit(1)", EndKind.CRASHED, "1", 1),
    ],
    ids=range(16),
)  # fmt: skip
def test_every_end_is_an_outcome_and_keeps_what_there_is(run, edit, kind, says, posed):
    record = run(edit, limits="{start_s: 2, slow_down: 0.001, memory_mb: 300}")
    assert record.ending.kind is kind and says in record.ending.message
    assert sum(len(t.frames) for t in record.trajectories) == posed
    assert len(record.results) == FRAMES and summarise(record)["ended"] == kind.value


def test_what_it_prints_is_kept_up_to_a_size(run, tmp_path, monkeypatch):
    monkeypatch.setattr(guarded, "_LOG_BYTES", 5000)
    record = run("[print('x' * 1000) for _ in range(5000)]; print('the last'); raise SystemExit(2)")
    assert (tmp_path / LOG_FILE).stat().st_size == 5000 and record.ending.message.endswith("the last")


DETACHED = """
import os, sys, time
if os.fork():
    time.sleep(WAITS)
else:
    os.setsid()
    if os.fork() == 0:
        open(PID, "w").write(str(os.getpid()))
        time.sleep(300)
os._exit(0)
"""


@pytest.mark.parametrize(
    ("waits_s", "kind"),
    [(0.5, EndKind.FINISHED), pytest.param(100, EndKind.TIMED_OUT, marks=pytest.mark.slow)],
)
def test_all_of_its_processes_end_with_it_also_those_that_have_left_its_session(run, tmp_path, waits_s, kind):
    code = DETACHED.replace("WAITS", str(waits_s)).replace("PID", repr(str(tmp_path / "pid")))
    edit = f"import subprocess; subprocess.run([sys.executable, '-c', {code!r}], check=False)"
    record = run(edit, limits="{start_s: 2, slow_down: 0.001}")
    assert record.ending.kind is kind and _is_gone(int((tmp_path / "pid").read_text()))


def test_it_ends_when_the_lab_is_killed_and_its_folder_is_swept(tmp_path, monkeypatch):
    script = f"""
import sys
from pathlib import Path
from dslab.experiments.runs.systems.guarded import run_guarded
code = {DETACHED.replace("WAITS", "300").replace("PID", repr(str(tmp_path / "pid")))!r}
run_guarded([sys.executable, "-c", code], Path({str(tmp_path / "log")!r}), 300, 1000, Path({str(tmp_path)!r}))
"""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    lab = subprocess.Popen([sys.executable, "-c", script])
    pid = _read_soon(tmp_path / "pid")
    os.kill(lab.pid, signal.SIGKILL)
    lab.wait()
    assert _is_gone(pid)
    monkeypatch.setattr(tempfile, "tempdir", None)
    sweep_scratch()
    assert not any((tmp_path / "tmp").iterdir())


def _read_soon(path: Path) -> int:
    for _ in range(600):
        if path.exists() and path.read_text():
            return int(path.read_text())
        time.sleep(0.05)
    raise AssertionError("it did not start")


def _is_gone(pid: int) -> bool:
    for _ in range(100):
        if not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
            return True
        time.sleep(0.05)
    return False


# -- descriptions --------------------------------------------------------------------------------------------


def test_a_description_may_be_like_another_one(tmp_path, sequence):
    write_program(tmp_path, sequence, settings="{features: 1000, vocabulary: null}")
    (tmp_path / "more.yaml").write_text("like: copy\nsettings: {features: 2000}\n")
    spec = read_command_spec(tmp_path / "more.yaml", (tmp_path,))
    assert spec.settings == {"features": 2000, "vocabulary": None}
    assert str(tmp_path / "program.py") in spec.command


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"command": "'slam {sequence} {output}'"}, "copy.yaml:1: command: unknown placeholder {output}"),
        ({"command": "'slam {sequence}'"}, "does not say where {out} goes"),
        ({"comand": "x"}, "comand: unknown key; use command (did you mean that?)"),
        ({"reads": "rosbag"}, "reads: 'rosbag' is not valid"),
        ({"trajectory": "../../secret"}, "is no file below {out}"),
        ({"live": "live_*.txt"}, "has a * too many; put one into trajectory and keyframes"),
        ({"environment": "{note: x}"}, "give packages or a commit of this lab"),
        ({"like": "nothing"}, "there is no other system 'nothing'"),
        ({"limits": "{memory_mb: -1}"}, "limits.memory_mb: -1 is not valid"),
        ({"command": "'no-such-program-at-all {sequence} {out}'"}, "no such command: no-such-program-at-all"),
        ({"environment": "{packages: [left-pad]}"}, "run `dslab systems install copy`"),
    ],
)  # fmt: skip
def test_a_description_that_is_wrong_is_one_line(dslab, monkeypatch, tmp_path, sequence, fields, says):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "cache"))
    if "environment" in fields:
        fields = {**fields, "command": "'{python} {sequence} {out}'"}
    write_program(tmp_path / "s", sequence, **fields)
    words = ("--system", "copy", "--systems", tmp_path / "s", "--out", tmp_path / "r")
    code, out, err = dslab("run", "clean-room", *words)
    assert (code, out) == (2, "") and says in err and err.count("\n") == 1
    assert not (tmp_path / "r").exists()


def test_a_run_by_the_command_has_the_log_and_the_settings(
    dslab, monkeypatch, no_picture, tmp_path, sequence
):
    monkeypatch.setattr(sources, "open_sequence", lambda *_, **__: sequence)
    monkeypatch.setenv("DSLAB_SYSTEMS", str(tmp_path / "s"))
    write_program(tmp_path / "s", sequence, "print('hello')", settings="{features: 7}")
    code, _, _ = dslab("run", "x", "--system", "copy", "--out", tmp_path / "r")
    assert code == 0 and (tmp_path / "r" / LOG_FILE).read_text() == "hello\n"
    assert json.loads((tmp_path / "r" / "settings.json").read_text()) == {"features": 7}
    assert np.loadtxt(tmp_path / "r" / "trajectory.txt").shape == (FRAMES, 8)


def test_files_that_are_not_as_described_end_the_command_after_all_is_written(
    dslab, monkeypatch, no_picture, tmp_path, sequence
):
    monkeypatch.setattr(sources, "open_sequence", lambda *_, **__: sequence)
    write_program(tmp_path / "s", sequence, "rows[0][0] = '99'")
    words = ("--system", "copy", "--systems", tmp_path / "s", "--out", tmp_path / "r")
    code, _, err = dslab("run", "x", *words)
    assert code == 2 and "99.000000 s is the time of no frame" in err and err.count("\n") == 1
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["ended"] == "other_stamps"


def test_names_that_are_taken_and_folders_that_are_missing_are_refused(dslab, tmp_path, sequence):
    path = write_program(tmp_path / "s", sequence)
    path.rename(path.with_name("dual.yaml"))
    assert "the name dual is taken" in dslab("systems", "list", "--systems", tmp_path / "s")[2]
    assert "no such folder" in dslab("systems", "list", "--systems", tmp_path / "none")[2]


def test_the_list_says_of_each_whether_it_can_run(dslab, monkeypatch, tmp_path, sequence):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "260")
    write_program(tmp_path / "s", sequence, about="copies", comand="x")
    code, out, _ = dslab("systems", "list", "--systems", tmp_path / "s")
    rows = {line.split()[0]: line for line in out.splitlines() if line.strip()}
    assert code == 0 and "ready" in rows["paper+"] and "unknown key" in rows["copy"]
    assert "dslab systems install orbslam3" in rows["orbslam3"] and "svo-cpp" in rows["svo"]


def test_what_cannot_be_started_by_the_system_is_bad_input(run, tmp_path, sequence):
    script = tmp_path / "no-interpreter"
    script.write_text("#!/no/such/interpreter\n")
    script.chmod(0o755)
    with pytest.raises(InputError, match="cannot be run"):
        run(command=f"'{script} {{sequence}} {{out}}'")
