"""Environments of other people's systems, made without the network; what comes with the lab for them."""

import json
import os
import runpy
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slam_fakes import make_sequence

from dslab.experiments.evaluation.alignment import align_poses, rotation_angle_deg
from dslab.experiments.evaluation.metrics import associate, position_errors_m
from dslab.experiments.runs.ending import EndKind
from dslab.experiments.runs.sources import open_sequence
from dslab.experiments.runs.systems import environments, release_source
from dslab.experiments.runs.systems.command import LOG_FILE
from dslab.experiments.runs.systems.command_spec import OWN_FOLDER, Environment
from dslab.experiments.runs.systems.environments import install, is_installed, python_of
from dslab.experiments.runs.systems.registry import Registry
from dslab.experiments.runs.systems.run import run_system
from dslab.experiments.runs.systems.vocabulary_text import vocabulary_of, write_dbow2
from dslab.scenarios.errors import InputError, MachineError
from dslab.sim.io.orbslam3 import orbslam3_settings
from dslab.sim.io.tum import write_tum
from dslab.sim.sensors.camera import Intrinsics
from dslab.slam.places import _vocabulary_kernels as kernels
from dslab.slam.places.recognition import shipped_vocabulary

DRIVERS = OWN_FOLDER / "drivers"
ROOT = Path(__file__).parents[4]


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def wheel(tmp_path):
    """A package without needs, beside a later version of it."""
    for version in ("2.0", "1.0"):
        path = tmp_path / f"tiny_slam-{version}-py3-none-any.whl"
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("tiny_slam.py", f"version = '{version}'\n")
            about = f"tiny_slam-{version}.dist-info"
            file.writestr(
                f"{about}/METADATA", f"Metadata-Version: 2.1\nName: tiny_slam\nVersion: {version}\n"
            )
            file.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
            file.writestr(f"{about}/RECORD", "")
    return path


@pytest.mark.parametrize("with_uv", [True, False])
@pytest.mark.slow
def test_an_environment_is_made_apart_and_only_counts_when_whole(monkeypatch, cache, wheel, with_uv):
    uv = shutil.which("uv") or shutil.which("uv", path=str(ROOT / ".tools" / "bin"))
    if with_uv and uv is None:
        pytest.skip("uv is not here")
    monkeypatch.setattr(environments.shutil, "which", lambda name: uv if with_uv else None)
    tiny = Environment(packages=(str(wheel),), imports=("tiny_slam",))
    with pytest.raises(InputError, match="run `dslab systems install tiny`"):
        python_of("tiny", tiny)
    assert install("tiny", tiny) == cache / "systems" / "tiny" and is_installed("tiny", tiny)
    said = subprocess.run([python_of("tiny", tiny), "-c", "import tiny_slam, sys; print(sys.prefix)"],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert Path(said.stdout.strip()).resolve() == (cache / "systems" / "tiny").resolve()
    assert not is_installed("tiny", Environment(packages=(str(wheel), "more")))


@pytest.fixture
def repository(tmp_path):
    """A repository with one commit, which installs a ``slam`` and a ``dslab warmup``; and the commit."""
    folder = tmp_path / "lab"
    (folder / "slam").mkdir(parents=True)
    (folder / "slam" / "__init__.py").write_text(
        "def main():\n    print(open(__file__ + '.warm', 'w').write('x'))\n"
    )
    (folder / "pyproject.toml").write_text(PROJECT)
    (folder / "backend.py").write_text(BACKEND)
    locked = "[[package]]\nname='{}'\nversion='{}'\nsource={{registry='x'}}\nresolution-markers=[\"{}\"]\n"
    others = [("tiny_slam", "1.0", "python_version > '3'"), ("tiny_slam", "9.0", "python_version < '3'")]
    (folder / "uv.lock").write_text("".join(locked.format(*other) for other in others))
    about = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], ["add", "."], [*about, "commit", "-qm", "one"]):
        subprocess.run(["git", "-C", folder, *words], check=True)
    told = subprocess.run(
        ["git", "-C", folder, "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    )
    shutil.rmtree(folder / "slam")  # the commit counts, not the work tree
    return folder, told.stdout.strip()


PROJECT = """
project = {name = "lab", version = "7", dependencies = ["tiny_slam"], scripts = {dslab = "slam:main"}}
build-system = {requires = [], build-backend = "backend", backend-path = ["."]}
"""
# Builds without a package from an index.
BACKEND = """
import pathlib, zipfile
def build_wheel(directory, *_):
    about = {"METADATA": "Metadata-Version: 2.1\\nName: lab\\nVersion: 7\\nRequires-Dist: tiny_slam\\n",
             "WHEEL": "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n",
             "entry_points.txt": "[console_scripts]\\ndslab = slam:main\\n", "RECORD": ""}
    with zipfile.ZipFile(pathlib.Path(directory) / "lab-7-py3-none-any.whl", "w") as file:
        file.write("slam/__init__.py")
        for name, text in about.items():
            file.writestr(f"lab-7.dist-info/{name}", text)
    return "lab-7-py3-none-any.whl"
"""


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not here")
@pytest.mark.slow
def test_a_commit_is_installed_with_its_locked_versions_and_warm(
    dslab, monkeypatch, cache, wheel, repository
):
    folder, commit = repository
    monkeypatch.setenv("PYTHONPATH", str(ROOT))  # whose packages must not be taken for the commit's
    monkeypatch.setenv("PATH", str(ROOT / ".tools" / "bin"), prepend=os.pathsep)
    for tool in ("PIP", "UV"):
        monkeypatch.setenv(f"{tool}_NO_INDEX", "1")
        monkeypatch.setenv(f"{tool}_FIND_LINKS", str(wheel.parent))
    name = f"base@{commit[:9]}"
    code, _, err = dslab("systems", "install", name, "--repository", folder.as_uri())
    assert code == 0, err
    system = Registry.open().find(name)
    python = python_of(name, system.spec.environment)
    (packages,) = python.parents[1].glob("lib/*/site-packages")
    assert (packages / "slam" / "__init__.py.warm").exists()
    assert (packages / "tiny_slam-1.0.dist-info").is_dir(), "as its uv.lock says"
    assert system.check() and Registry.open().find(f"dso@{commit[:9]}").check()


def test_a_commit_that_is_not_to_be_had_is_one_line(dslab, monkeypatch, cache, tmp_path):
    monkeypatch.setattr(release_source, "checkout", lambda: None)
    code, _, err = dslab("systems", "install", "lab@0.2.0")
    assert code == 2 and "runs from no clone of its repository; name a clone of it" in err
    if shutil.which("git") is not None:
        subprocess.run(["git", "init", "-q", tmp_path / "empty"], check=True)
        code, _, err = dslab("systems", "install", "lab@0.2.0", "--repository", tmp_path / "empty")
        assert code == 2 and "has no commit 019e78a64cfe" in err and "git fetch --unshallow" in err
    code, _, err = dslab("systems", "install", "lab@0.2.0", "--repository", tmp_path)
    assert code == 1 and err.count("\n") == 1
    assert list((cache / "systems").iterdir()) == []


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("bose@0.2.0", "no system 'bose@0.2.0'; give one of base@0.2.0, dual@0.2.0"),
        ("base@0.2", "no release '0.2'; give 0.2.0 or a commit"),
        ("base@0.2.0", "run `dslab systems install base@0.2.0`"),
    ],
)
def test_systems_of_releases_are_known_by_name(dslab, cache, name, says):
    code, _, err = dslab("systems", "check", name)
    assert code == 2 and says in err and err.count("\n") == 1


@pytest.mark.slow
def test_one_that_cannot_be_made_leaves_nothing_and_says_so(monkeypatch, cache, wheel):
    broken = Environment(packages=(str(wheel),), imports=("no_such_module",), note="install libslam")
    with pytest.raises(MachineError, match=r"No module named 'no_such_module'; install libslam"):
        install("tiny", broken)
    assert list((cache / "systems").iterdir()) == []


def test_what_has_no_environment_is_not_installed(dslab):
    code, _, err = dslab("systems", "install", "dual")
    assert code == 2 and "has no environment to install" in err


def test_those_that_come_with_the_lab_are_described_and_say_what_they_need(cache):
    registry = Registry.open()
    for name in ("orbslam3", "svo"):
        system = registry.find(name)
        assert system.spec.pace == "real_time" and system.spec.lost_states
        with pytest.raises(InputError, match=f"run `dslab systems install {name}`"):
            system.check()
    assert registry.find("svo").spec.settings["quality_max_drop_fts"] == 300


def test_our_vocabulary_as_text_is_the_same_tree(tmp_path):
    vocabulary = shipped_vocabulary()
    write_dbow2(vocabulary, tmp_path / "v.txt")
    head, *lines = (tmp_path / "v.txt").read_text().splitlines()
    assert head.split() == ["10", "6", "0", "0"] and not (tmp_path / "v.txt").read_text().endswith("\n")
    rows = np.array([line.split() for line in lines], float)
    parent, is_word = rows[:, 0].astype(int), rows[:, 1].astype(bool)
    centre = rows[:, 2:34].astype(np.uint8)
    assert (parent <= np.arange(len(rows))).all()
    children = {p: np.flatnonzero(parent == p) + 1 for p in set(parent.tolist())}
    described = np.random.default_rng(0).integers(0, 256, (20, 32), dtype=np.uint8)
    words = kernels.descend(vocabulary.tree, described.view(np.uint64))
    number = np.cumsum(is_word) - 1
    for row, word in zip(described, words, strict=True):
        node = 0
        while node in children:
            below = children[node]
            distance = np.unpackbits(centre[below - 1] ^ row, axis=1).sum(axis=1)
            node = int(below[distance.argmin()])
        # Words are numbered otherwise there; their weights tell them.
        assert rows[node - 1, 34] == pytest.approx(vocabulary.tree.weight[word], abs=1e-5)
    assert number[-1] + 1 == vocabulary.n_words


def test_the_result_says_whose_vocabulary_it_was(cache, tmp_path):
    path, said = vocabulary_of(None)
    assert path.is_file() and said.startswith("dual-slam-lab's own of 10000 words")
    (tmp_path / "own.txt").touch()
    assert vocabulary_of(tmp_path / "own.txt") == (tmp_path / "own.txt", str(tmp_path / "own.txt"))
    with pytest.raises(InputError, match="no such file"):
        vocabulary_of(tmp_path / "none.txt")


def test_quaternions_of_the_drivers_are_right(monkeypatch):
    monkeypatch.syspath_prepend(str(DRIVERS))
    quaternion_xyzw = runpy.run_path(str(DRIVERS / "driver_files.py"))["quaternion_xyzw"]
    turns = [*Rotation.random(50, random_state=0), *(Rotation.from_euler("xyz", e, degrees=True)
             for e in ([180, 0, 0], [0, 180, 0], [0, 0, 180], [0, 0, 0]))]  # fmt: skip
    for turn in turns:
        found = Rotation.from_quat(quaternion_xyzw(turn.as_matrix()))
        assert (found * turn.inv()).magnitude() < 1e-6


STUB = """
import enum
import numpy as np
Sensor = enum.Enum("Sensor", "MONOCULAR")
State = enum.Enum("State", "NOT_INITIALIZED OK RECENTLY_LOST")
class Result:
    def __init__(self, state, n):
        self.state, self.ok, self.pose_valid = state, state is State.OK, state is not State.NOT_INITIALIZED
        self.pose_wc = np.eye(4)
        self.pose_wc[0, 3] = n
class Slam:
    def __init__(self, vocabulary, settings, sensor, use_viewer):
        assert open(settings).read().startswith("%YAML") and open(vocabulary).read() == "words"
        self.stamps = []
    def track_monocular(self, image, stamp_s):
        assert image.shape == (48, 64)
        self.stamps.append(stamp_s)
        n = len(self.stamps)
        return Result(State.NOT_INITIALIZED if n < 4 else State.RECENTLY_LOST if n == 8 else State.OK, n)
    def shutdown(self):
        print("down")
    def save_trajectory_euroc(self, path):
        rows = (f"{1e9 * s:.6f} {n} 0 0 0 0 0 1" for n, s in enumerate(self.stamps, 1) if n >= 4)
        open(path, "w").write("\\n".join(rows))
    def save_keyframe_trajectory_euroc(self, path):
        open(path, "w").write(f"{1e9 * self.stamps[4]:.6f} 5 0 0 0 0 0 1\\n")
"""


@pytest.mark.slow
def test_the_driver_of_orbslam3_keeps_the_poses_of_tracked_frames_only(tmp_path):
    """Its package is a stub, as the real one is not among ours."""
    (tmp_path / "pyorbslam3.py").write_text(STUB)
    (tmp_path / "vocabulary.txt").write_text("words")
    settings = {"features": 1000, "loops": True, "speed": 0}
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    (tmp_path / "out").mkdir()
    sequence = make_sequence(12, segment=None)
    write_tum(sequence, tmp_path / "seq")
    script = DRIVERS / "orbslam3_driver.py"
    words = [
        script,
        tmp_path / "seq",
        tmp_path / "out",
        tmp_path / "vocabulary.txt",
        tmp_path / "settings.json",
    ]
    done = subprocess.run(
        [sys.executable, *words],
        env={"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    kept = np.loadtxt(tmp_path / "out" / "trajectory.txt")
    tracked = [3, 4, 5, 6, 8, 9, 10, 11]
    np.testing.assert_allclose(kept[:, 0], sequence.stamps_s[tracked], atol=1e-8)
    assert len(np.loadtxt(tmp_path / "out" / "live.txt")) == len(tracked)
    assert np.loadtxt(tmp_path / "out" / "keyframes.txt")[1] == 5
    states = [line.split(",")[1] for line in (tmp_path / "out" / "frames.csv").read_text().splitlines()[1:]]
    assert states[7] == "RECENTLY_LOST" and len(states) == 12


@pytest.mark.parametrize(
    ("size", "asked", "features"),
    [((640, 480), None, 1000), ((1242, 375), None, 2000), ((1242, 375), 1500, 1500)],
)
def test_orbslam3_has_the_features_of_its_own_settings(monkeypatch, size, asked, features):
    monkeypatch.syspath_prepend(str(DRIVERS))
    monkeypatch.setitem(sys.modules, "pyorbslam3", ModuleType("pyorbslam3"))
    settings_text = runpy.run_path(str(DRIVERS / "orbslam3_driver.py"))["settings_text"]
    own = orbslam3_settings(Intrinsics(*size, 500.0, 500.0, 300.0, 180.0, 30.0))
    text = settings_text(own, {"features": asked, "loops": True})
    assert f"nFeatures: {features}\n" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    # SVO loses small rooms within a second, and the first turn of ``stressed`` after six.
    ("name", "source", "tracked"),
    [("orbslam3", "small/room", 75), ("svo", "stressed", 90)],
)
def test_the_real_ones_track_where_they_are_installed(name, source, tracked, tmp_path):
    system = Registry.open().find(name)
    if not is_installed(name, system.spec.environment):
        pytest.skip(f"{name} is not installed")
    sequence = open_sequence(source)
    record = run_system(system, sequence, 0, folder=tmp_path)
    assert record.ending.kind is EndKind.FINISHED, (tmp_path / LOG_FILE).read_text()
    path = record.trajectories[0]
    assert len(path.frames) >= tracked
    pairs = associate(path, sequence.stamps_s, sequence.T_world_cam)
    alignment = align_poses(pairs.T_map_cam, pairs.T_world_cam)
    turned = (
        alignment.R_world_map @ pairs.T_map_cam[:, :3, :3] @ pairs.T_world_cam[:, :3, :3].transpose(0, 2, 1)
    )
    assert np.median(rotation_angle_deg(turned)) < 2
    assert np.median(position_errors_m(pairs, alignment)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["base", "ldso"])
def test_a_system_of_a_release_gives_what_the_release_itself_gives_where_it_is_installed(
    dslab, tmp_path, kind
):
    system = Registry.open().find(f"{kind}@0.2.0")
    if not is_installed(system.name, system.spec.environment):
        pytest.skip("lab@0.2.0 is not installed")
    write_tum(open_sequence("small/room"), tmp_path / "room")
    assert dslab("run", tmp_path / "room", "--system", system.name, "--out", tmp_path / "ours")[0] == 0
    python = python_of(system.name, system.spec.environment)
    own = [python, "-E", "-s", python.with_name("dslab"), "run", tmp_path / "room"]
    subprocess.run([*own, "--system", kind, "--out", tmp_path / "its"], check=True, capture_output=True)
    for name in ("trajectory.txt", "keyframes.txt"):
        assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "its" / name).read_bytes()
    events = [
        [
            {k: v for k, v in json.loads(line).items() if not k.endswith("_ms") and v is not None}
            for line in (tmp_path / of / "events.jsonl").read_text().splitlines()
        ]
        for of in ("ours", "its")
    ]
    assert events[0] == events[1] and len(events[0]) > 0
