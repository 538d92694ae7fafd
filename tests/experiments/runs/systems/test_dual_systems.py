"""Dual-SLAM over classes and programs: what is run when, on which frames, and how it ends."""

from dataclasses import replace

import numpy as np
import pytest
from slam_fakes import make_sequence
from system_programs import program

from dslab.experiments.eq1.units import system_label
from dslab.experiments.result_folder import run_systems
from dslab.experiments.runs.ending import EndKind
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.registry import (
    DualSystem,
    OwnSystem,
    Registry,
    split_names,
    system_digest,
    takes_real_time,
)
from dslab.experiments.runs.systems.run import run_system
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import RecoveryEnd

FRAMES, GAP = 140, range(60, 70)


@pytest.fixture
def sequence():
    """Frames that carry their numbers."""
    made = make_sequence(FRAMES, segment=None)
    images = np.zeros((FRAMES, *made.frames[0].shape), np.uint8)
    images[:, 0, 0] = np.arange(FRAMES)
    return replace(made, frames=images)


class Blind:
    """Knows the truth but for the gap, in a scale of its own; once lost it stays lost."""

    truth = make_sequence(FRAMES, segment=None).T_world_cam
    gap = GAP

    def __init__(self, camera, seed):
        self.seen, self.begun, self.lost, self.scale = [], False, False, 0.5 + seed % 7

    def process(self, image, stamp_s):
        self.seen.append(int(image[0, 0]))
        self.lost |= self.seen[-1] in self.gap and self.begun
        self.begun = not self.lost and self.seen[-1] not in self.gap
        if not self.begun:
            return None
        T = self.truth[self.seen[-1]].copy()
        T[:3, 3] *= self.scale
        return T


class Sighted(Blind):
    """Crosses the gap as well."""

    gap = ()


class Fragile(Sighted):
    """Raises in the gap if it comes from behind it."""

    def process(self, image, stamp_s):
        if self.seen and self.seen[-1] > image[0, 0] and image[0, 0] in GAP:
            raise RuntimeError("not that way")
        return super().process(image, stamp_s)


class Fickle(Sighted):
    """Answers in another scale with every call."""

    def process(self, image, stamp_s):
        self.scale *= 1.02
        return super().process(image, stamp_s)


# The program: as `Blind` forward, in states; it sees all backward.
STATES = """
import cv2
names = [line.split()[1] for line in listed if line[0] != "#"]
order = [int(cv2.imread(str(seq / name), cv2.IMREAD_GRAYSCALE)[0, 0]) for name in names]
blind = range(60, 70) if order[0] < order[-1] else ()
lost = next((k for k, i in enumerate(order) if i in blind and k and order[0] < 60), len(order))
posed = [k for k, i in enumerate(order) if k < lost and i not in blind]
scale = 1.0 + order[0]
known = [(stamps[k], poses[order[k]]) for k in posed]
rows = [[stamp, *(str(scale * float(x)) for x in p[1:4]), *p[4:]] for stamp, p in known]
states = ["OK" if k in posed else "LOST" if k >= lost else "NOT_INITIALIZED" for k in range(len(order))]
(out / "frames.csv").write_text("stamp_s,state\\n" + "".join(f"{s},{w}\\n" for s, w in zip(stamps, states)))
with pathlib.Path(__file__).with_name("runs.txt").open("a") as told:
    told.write(f"{order[0]} {order[-1]} {sorted(p.name for p in seq.iterdir())}\\n")
"""


def classes(forward, *recoveries) -> DualSystem:
    made = [ClassSystem(kind.__name__, kind, f"here:{kind.__name__}") for kind in (forward, *recoveries)]
    return DualSystem("dual", made[0], tuple(made[1:]))


def test_a_class_gains_a_recovery(sequence):
    alone = run_system(classes(Blind).forward, sequence, 0)
    assert alone.trajectories[0].frames[-1] == GAP[0] - 1
    record = run_system(classes(Blind, Sighted), sequence, 0)
    (path,) = record.trajectories
    assert path.frames.tolist() == list(range(FRAMES))
    np.testing.assert_allclose(path.T_map_cam[:, :3, 3], 0.5 * Blind.truth[:, :3, 3], atol=1e-6)
    breakage = next(e for e in record.events if e.kind == "breakage")
    assert (breakage.frame, breakage.reason) == (GAP[0], "no_pose"), "it declares nothing, and is watched"
    assert record.ending.kind is EndKind.FINISHED and record.config["code"]


@pytest.mark.parametrize(
    ("recovery", "stage", "reason"),
    [(Blind, "propagation", "no_pose"), (Fragile, "propagation", "crashed"), (Fickle, "sim3", "residual")],
)
def test_a_recovery_of_a_class_that_fails_is_an_outcome_with_its_reason(sequence, recovery, stage, reason):
    record = run_system(classes(Blind, recovery), sequence, 0)
    ends = {(e.success, e.stage, e.reason) for e in record.events if isinstance(e, RecoveryEnd)}
    assert ends == {(False, stage, reason)}
    assert [len(path.frames) for path in record.trajectories] == [FRAMES - GAP[-1] - 1, GAP[0]]


def test_a_class_that_is_lost_from_the_first_frame_has_no_breakage(sequence):
    class Never(Blind):
        gap = range(FRAMES)

    record = run_system(classes(Never, Sighted), sequence, 0)
    assert (record.trajectories, record.events) == ((), ())


class Torn:
    """Images of which one cannot be read."""

    def __init__(self, images, torn):
        self.images, self.torn = images, torn

    def __len__(self):
        return len(self.images)

    def __getitem__(self, frame):
        if frame == self.torn:
            raise InputError(f"frame {frame}", "cannot be read", "leave it out")
        return self.images[frame]


def test_a_frame_that_cannot_be_read_shifts_no_segment_of_a_program(sequence, tmp_path):
    fields = {"frames": "frames.csv", "lost_states": "[LOST]"}
    made = program(tmp_path / "systems", sequence, STATES, **fields)
    torn = replace(sequence, frames=Torn(sequence.frames, 20))
    record = run_system(DualSystem("dual(copy)", made, (made,)), torn, 0)
    (path,) = record.trajectories
    assert len(path.frames) == FRAMES - 1 and record.unreadable_frames == 1
    np.testing.assert_allclose(path.stamps_s, np.delete(sequence.stamps_s, 20))
    truth = np.delete(sequence.T_world_cam, 20, axis=0)[:, :3, 3]
    np.testing.assert_allclose(
        path.T_map_cam[:, :3, 3] - path.T_map_cam[0, :3, 3], truth - truth[0], atol=1e-6
    )


def test_a_program_is_run_in_segments_forward_and_then_backward(sequence, tmp_path):
    fields = {"frames": "frames.csv", "lost_states": "[LOST]"}
    made = program(tmp_path / "systems", sequence, STATES, **fields)
    record = run_system(DualSystem("dual(copy)", made, (made,)), sequence, 0)
    (path,) = record.trajectories
    assert path.frames.tolist() == list(range(FRAMES))
    np.testing.assert_allclose(path.T_map_cam[:, :3, 3], Blind.truth[:, :3, 3], atol=1e-5)
    told = [line.split(" ", 2) for line in (tmp_path / "systems" / "runs.txt").read_text().splitlines()]
    assert [(int(first), int(last)) for first, last, _ in told] == [(0, 139), (61, 139), (99, 0)]
    assert all("groundtruth" not in files for *_, files in told)


def test_a_recording_of_a_run_with_a_map_of_two_poses_is_made(sequence, tmp_path):
    class Stumbling(Blind):
        gap = (2, *GAP)

    system = classes(Stumbling, Sighted)
    summary = run_systems(sequence, ["dual"], 0, tmp_path, recording=True, plugins={"dual": system})["dual"]
    assert summary["breakages"] == 2 and (tmp_path / "recording.rrd").stat().st_size > 10_000


def test_names_say_what_it_is_made_of():
    found = Registry.open().find("dual(base, recovery=ldso, recovery=base@0.2.0)")
    assert found.name == "dual(base,recovery=ldso,recovery=base@0.2.0)"
    assert found.forward == OwnSystem("base") and next(part.name for part in found.recoveries) == "ldso"
    assert split_names("base, dual(base, recovery=ldso),ldso") == [
        "base",
        "dual(base, recovery=ldso)",
        "ldso",
    ]
    named = "dual(examples/own_slam.py:ConstantVelocity, recovery=base)"
    assert system_label(named) == Registry.open().find(named).name == "dual(ConstantVelocity,recovery=base)"
    assert system_digest(Registry.open().find(named)) and not system_digest(
        Registry.open().find("dual(base)")
    )
    assert takes_real_time(Registry.open().find("dual(base, recovery=orbslam3)"))


@pytest.mark.parametrize(
    "name", ["dual()", "dual(dual)", "dual(dual(base))", "dual(base, ldso)", "dual(bas)"]
)
def test_a_name_that_stands_for_nothing_is_refused_in_one_line(name):
    with pytest.raises(InputError) as caught:
        Registry.open().find(name)
    assert "\n" not in str(caught.value)
