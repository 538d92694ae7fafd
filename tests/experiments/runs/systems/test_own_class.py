"""A class of one's own: its poses become a record, and what it does wrong an outcome."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from slam_fakes import make_sequence

from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs import sources
from dslab.experiments.runs.ending import Declares, EndKind
from dslab.experiments.runs.systems import own_class
from dslab.experiments.runs.systems.own_class import ClassSystem, class_system
from dslab.experiments.runs.systems.registry import Registry, system_digest
from dslab.experiments.runs.systems.run import run_system
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import Breakage, Relocalized
from dslab.slam.core.relation import PlacedFrames, Relation

EXAMPLE = Path(__file__).parents[4] / "examples" / "own_slam.py"
FRAMES = 60


class Replay:
    """Gives the truth, but for some frames."""

    truth = make_sequence(FRAMES, segment=None).T_world_cam
    without = range(20, 30)

    def __init__(self, camera, seed):
        self.frame = -1

    def process(self, image, stamp_s):
        self.frame += 1
        return None if self.frame in self.without else self.truth[self.frame]


@pytest.fixture
def sequence():
    return make_sequence(FRAMES, segment=None)


def run(kind, sequence):
    system = ClassSystem("own", kind, "here:own")
    return run_system(system, sequence, 0)


def test_its_poses_are_the_live_and_the_final_ones_and_frames_without_one_are_lost(sequence):
    record = run(Replay, sequence)
    posed = [f for f in range(FRAMES) if f not in Replay.without]
    assert record.trajectories[0].frames.tolist() == record.live[0].frames.tolist() == posed
    np.testing.assert_array_equal(record.trajectories[0].T_map_cam, Replay.truth[posed])
    assert {str(record.results[f].state) for f in Replay.without} == {"lost"}
    assert (record.ending.kind, record.declares) == (EndKind.FINISHED, Declares.NOTHING)


def test_what_it_does_to_an_image_reaches_no_other_system(sequence):
    class Painter(Replay):
        def process(self, image, stamp_s):
            image[:] = 0
            return super().process(image, stamp_s)

    before = sequence.frames.copy()
    assert run(Painter, sequence).ending.kind is EndKind.FINISHED
    np.testing.assert_array_equal(sequence.frames, before)


def test_the_poses_of_finish_replace_the_live_ones(sequence):
    class Smoothing(Replay):
        def finish(self):
            return list(self.truth)

    record = run(Smoothing, sequence)
    assert len(record.trajectories[0].frames) == FRAMES and len(record.live[0].frames) == FRAMES - 10


def test_what_it_declares_is_a_breakage_in_its_own_words(sequence):
    class Saying(Replay):
        def __init__(self, camera, seed):
            super().__init__(camera, seed)
            self.events = []

        def process(self, image, stamp_s):
            pose = super().process(image, stamp_s)
            if self.frame == 20:
                self.events.append((stamp_s, "all dark"))
            return pose

    record = run(Saying, sequence)
    (event,) = record.events
    assert isinstance(event, Breakage) and (event.frame, event.reason) == (20, "all dark")
    assert record.declares is Declares.LOSSES


@pytest.mark.parametrize(
    ("given", "kind", "posed"),
    [
        (lambda T: 1 / 0, EndKind.CRASHED, 9),
        (lambda T: sys.exit(3), EndKind.CRASHED, 9),
        (lambda T: T * np.nan, EndKind.NOT_FINITE, FRAMES - 11),
        (lambda T: "left", EndKind.UNREADABLE, FRAMES - 11),
        (lambda T: np.ones((4, 4)), EndKind.UNREADABLE, FRAMES - 11),
        (lambda T: T[:3], EndKind.UNREADABLE, FRAMES - 11),
    ],
)
def test_what_it_does_wrong_is_an_outcome_and_the_other_poses_count(sequence, given, kind, posed):
    class Faulty(Replay):
        def process(self, image, stamp_s):
            pose = super().process(image, stamp_s)
            return given(pose) if self.frame == 9 else pose

    record = run(Faulty, sequence)
    assert record.ending.kind is kind and record.ending.message
    assert len(record.results) == FRAMES and len(record.trajectories[0].frames) == posed


class Ends(BaseException):
    """What no `except Exception` stops; its words raise as well."""

    def __str__(self):
        raise Ends


class Raising:
    """Raises wherever it is looked at."""

    def __array__(self, *_, **__):
        raise Ends

    __len__ = __array__


def ends(*_):
    raise Ends


EVENT = {"frame": 9, "stamp_s": 0.3, "map_id": 0, "reason": "dark", "inliers": 3}
NO_SIDE = PlacedFrames(np.array([99]), np.zeros(1), np.eye(4)[None])
RELOCALIZED = {"frame": 9, "stamp_s": 0.3, "map_id": 0, "keyframe": 1, "first_frame": 9, "inliers": 3}
RELOCALIZED |= {"frames_lost": 1, "lost_s": 0.1, "relation": Relation(NO_SIDE, NO_SIDE, 1.0)}


@pytest.mark.parametrize(
    ("members", "kind"),
    [
        ({"process": ends}, EndKind.CRASHED),
        ({"process": lambda *_: os._exit(0)}, EndKind.CRASHED),
        ({"process": lambda *_: Raising()}, EndKind.CRASHED),
        ({"process": lambda *_: [[10**400] * 4] * 4}, EndKind.UNREADABLE),
        ({"process": lambda *_: np.full((4, 4), 1e300)}, EndKind.UNREADABLE),
        ({"finish": lambda _: Raising()}, EndKind.CRASHED),
        ({"finish": property(ends)}, EndKind.CRASHED),
        ({"events": property(ends)}, EndKind.CRASHED),
        ({"events": [(0.1, Ends())]}, EndKind.CRASHED),
        ({"events": [(10**400, "dark")]}, EndKind.UNREADABLE),
        ({"events": [(1e9, "dark")]}, EndKind.UNREADABLE),
        ({"events": [7]}, EndKind.UNREADABLE),
        ({"events": [Breakage(**EVENT | {"frame": 10**9})]}, EndKind.UNREADABLE),
        ({"events": [Breakage(**EVENT | {"stamp_s": 10**400})]}, EndKind.UNREADABLE),
        ({"events": [Breakage(**EVENT | {"inliers": "?"})]}, EndKind.UNREADABLE),
        ({"events": [Relocalized(**RELOCALIZED)]}, EndKind.UNREADABLE),
    ],
    ids=range(16),
)
def test_whatever_it_raises_or_declares_is_an_outcome(sequence, members, kind):
    record = run(type("Hostile", (Replay,), members), sequence)
    assert record.ending.kind is kind and record.ending.message and record.events == ()
    assert summarise(record)["ended"] == kind.value and len(record.results) == FRAMES


def test_numbers_of_numpy_are_those_of_an_event_and_one_that_is_none_spoils_no_other(sequence):
    event = Breakage(**EVENT | {"frame": np.int64(9), "stamp_s": np.float32(0.5)})
    (found,) = run(type("Saying", (Replay,), {"events": [7, event]}), sequence).events
    assert found == event and (type(found.frame), type(found.stamp_s)) == (int, float)


RAISES = """
import numpy as np
class Own:
    def __init__(self, camera, seed):
        if seed == 1: self.deep()
    def process(self, image, stamp_s):
        return self.deep()
    def deep(self):
        return np.linalg.inv(np.zeros((2, 2)))
"""


def test_what_it_raises_is_said_with_its_own_line_and_the_log_of_the_result(
    dslab, monkeypatch, no_picture, tmp_path, sequence
):
    monkeypatch.setattr(sources, "open_sequence", lambda *_, **__: sequence)
    (tmp_path / "own.py").write_text(RAISES)
    words = ("run", "x", "--system", f"{tmp_path}/own.py:Own", "--out", tmp_path / "r")
    code, out, _ = dslab(*words, "--seed", "0")
    said = f"LinAlgError: Singular matrix, at {tmp_path}/own.py:9"
    assert code == 0 and said in json.loads((tmp_path / "r" / "summary.json").read_text())["ended_message"]
    assert "own.py:9" in out and f"log of Own  {tmp_path / 'r' / 'log.txt'}" in out
    log = (tmp_path / "r" / "log.txt").read_text()
    assert log.startswith("Traceback") and 'own.py", line 9, in deep' in log and "linalg" in log
    code, _, err = dslab(*words[:-1], tmp_path / "s", "--seed", "1")
    assert code == 2 and f"({said})" in err and err.count("\n") == 1


@pytest.mark.parametrize("member", ["__init__(self, *_)", "process"])
@pytest.mark.parametrize("way", ["raise SystemExit", "import os; os._exit(0)", "raise GeneratorExit"])
def test_one_that_ends_when_it_is_made_is_one_line(dslab, monkeypatch, tmp_path, sequence, member, way):
    monkeypatch.setattr(sources, "open_sequence", lambda *_, **__: sequence)
    get = "@property\n    " if member == "process" else ""
    member = f"{member}(self)" if get else member
    (tmp_path / "ends.py").write_text(f"class Own:\n    {get}def {member}:\n        {way}\n")
    words = ("run", "x", "--system", f"{tmp_path}/ends.py:Own", "--out", tmp_path / "r")
    code, _, err = dslab(*words)
    assert code == 2 and "cannot be made" in err and err.count("\n") == 1


def test_the_example_runs_by_the_command_beside_ours(dslab, monkeypatch, no_picture, tmp_path, sequence):
    from slam_fakes import fake_factory

    from dslab.experiments.runs import slam_settings

    monkeypatch.setattr(sources, "open_sequence", lambda *_, **__: sequence)
    monkeypatch.setattr(slam_settings, "factory_of", lambda _: fake_factory(sequence))
    code, out, _ = dslab("run", "x", "--system", f"base,{EXAMPLE}:ConstantVelocity", "--out", tmp_path / "r")
    assert code == 0 and "ConstantVelocity: declares nothing" in " ".join(out.split())
    own, base = (
        json.loads((tmp_path / "r" / name / "summary.json").read_text())
        for name in ("ConstantVelocity", "base")
    )
    assert own["share_posed"] == 1.0 and own["ate_m"] > 0.5 > base["ate_m"]
    assert (own["ended"], own["declares"], base["declares"]) == ("finished", "nothing", "events")
    assert (tmp_path / "r" / "ConstantVelocity" / "trajectory.txt").read_text().count("\n") == FRAMES + 1


def test_the_example_is_twelve_lines():
    code = EXAMPLE.read_text().partition("class ")[2].splitlines()
    assert len([line for line in code if line.strip() and '"""' not in line]) <= 12


def test_a_module_in_the_present_folder_is_found(tmp_path, monkeypatch):
    (tmp_path / "my_own_slam.py").write_text("class Mine:\n    process = None\n")
    monkeypatch.chdir(tmp_path)
    assert class_system("my_own_slam:Mine").name == "Mine"


@pytest.mark.parametrize(
    ("named", "says"),
    [
        ("no_such_module_at_all:Mine", "cannot be imported"),
        ("no/such/file.py:Mine", "no such file"),
        ("json:Mine", "is no class"),
        ("bse", "there is no system 'bse'; give base (did you mean that?), or one of base, dual"),
    ],
)
def test_a_name_that_is_none_is_one_line(dslab, tmp_path, named, says):
    code, out, err = dslab("run", "clean-room", "--system", named, "--out", tmp_path / "r")
    assert (code, out) == (2, "") and says in err and err.count("\n") == 1


def test_a_class_without_process_is_named(sequence):
    with pytest.raises(InputError, match=r"here:own: has no process\(image, stamp_s\)"):
        run(lambda camera, seed: object(), sequence)


def test_a_system_of_a_package_goes_by_its_entry_point(monkeypatch):
    from importlib.metadata import EntryPoint

    point = EntryPoint("replay", f"{__name__}:Replay", own_class.GROUP)
    monkeypatch.setattr(own_class, "entry_points", lambda group: [point] if group == own_class.GROUP else [])
    registry = Registry.open()
    assert "replay" in registry.names() and registry.find("replay").make is Replay


def test_a_map_of_a_system_without_one_is_refused(dslab, tmp_path):
    words = ("--system", f"{EXAMPLE}:ConstantVelocity", "--map", "--out", tmp_path / "r")
    code, _, err = dslab("run", "clean-room", *words)
    assert code == 2 and "--map: of ConstantVelocity only poses are known" in err


def test_a_check_tells_what_is_wrong(dslab, tmp_path):
    text = EXAMPLE.read_text().replace("return self.T_map_cam", "return self.T_map_cam * np.nan")
    (tmp_path / "bad_slam.py").write_text(text)
    assert dslab("systems", "check", f"{EXAMPLE}:ConstantVelocity")[0] == 0
    code, _, err = dslab("systems", "check", f"{tmp_path / 'bad_slam.py'}:ConstantVelocity")
    assert code == 2 and "not_finite" in err and err.count("\n") == 1


def test_a_sequence_without_truth_runs_too(sequence):
    assert len(run(Replay, replace(sequence, T_world_cam=None)).trajectories[0].frames) == FRAMES - 10


def test_python_takes_it_by_its_name_too(sequence):
    from dslab import experiments

    ran = experiments.run(sequence, f"{EXAMPLE}:ConstantVelocity")
    assert ran.system == "ConstantVelocity" and ran.metrics["share_posed"] == 1.0


def test_the_digest_of_a_class_in_a_file_changes_with_the_file_alone(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(EXAMPLE.read_text())
    named = f"{path}:ConstantVelocity"
    first, again = (system_digest(class_system(named)) for _ in range(2))
    path.write_text(EXAMPLE.read_text() + "\n# changed\n")
    assert first == again != system_digest(class_system(named))
