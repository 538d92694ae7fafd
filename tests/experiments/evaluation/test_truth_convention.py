"""A truth in another convention than it is read in is told by how the estimate turns."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.evaluation.audit_text import audit_text
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.evaluation.truth_convention import _steps, truth_fault
from dslab.experiments.runs.execution import execute
from dslab.slam.core.results import MapTrajectory

FPS, SECONDS = 10, 30


def poses(seed=0, sway=0.4):
    """A hand-held camera that looks about, camera to world, x right, y down, z forward."""
    t = np.arange(FPS * SECONDS) / FPS
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(0.4, 1.2, (3, 2)), rng.uniform(0, 6, (3, 2))
    angles = sway * np.sin(t[:, None, None] * rates + phases).sum(axis=2)
    T = np.tile(np.eye(4), (len(t), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(angles).as_matrix()
    T[:, :3, 3] = np.column_stack([t, np.sin(t), 0.2 * t])
    return t, T


def estimate(t, T, noise_deg=0.3):
    """In a frame of its own, at another scale, with an error in every orientation."""
    whole = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    found = T.copy()
    wrong = np.radians(noise_deg) * np.random.default_rng(1).normal(size=(len(t), 3))
    found[:, :3, :3] = whole @ T[:, :3, :3] @ Rotation.from_rotvec(wrong).as_matrix()
    found[:, :3, 3] = 0.3 * T[:, :3, 3] @ whole.T
    return MapTrajectory(0, np.arange(len(t)), t, found)


def with_rotations(T, change):
    changed = T.copy()
    changed[:, :3, :3] = change(T[:, :3, :3])
    return changed


def order(shift):
    return lambda R: Rotation.from_quat(np.roll(Rotation.from_matrix(R).as_quat(), shift, axis=1)).as_matrix()


READ = {
    "w x y z": order(1),
    "x y z w": order(-1),
    "world to the camera": lambda R: R.transpose(0, 2, 1),
    "OpenGL": lambda R: R @ np.diag([1.0, -1.0, -1.0]),
    "a body that carries the camera": lambda R: R @ Rotation.from_rotvec([0.5, 1.2, -0.8]).as_matrix(),
}


@pytest.mark.parametrize("convention", READ)
def test_the_convention_that_fits_is_named(convention):
    t, T = poses()
    said = truth_fault(Truth(t, with_rotations(T, READ[convention])), estimate(t, T))
    assert convention in said and "degrees a second" in said


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize(("sway", "noise_deg"), [(0.4, 0.3), (0.4, 5.0), (0.0, 1.0), (0.02, 1.0)])
def test_nothing_is_said_of_a_sound_truth(seed, sway, noise_deg):
    """However wrong the estimate is, and if the camera hardly turns."""
    t, T = poses(seed, sway)
    assert truth_fault(Truth(t, T), estimate(t, T, noise_deg)) == ""


def test_few_poses_and_a_still_camera_say_nothing():
    t, T = poses()
    wrong = with_rotations(T, READ["w x y z"])
    assert truth_fault(Truth(t, wrong), estimate(t[:30], T[:30])) == ""
    T[:] = np.eye(4)
    assert truth_fault(Truth(t, T), estimate(t, T, 0.0)) == ""


def test_a_gap_of_years_costs_nothing():
    """As where the first stamp is 0 and the others are of today."""
    stamps_s = np.concatenate([[0.0], 1.7e9 + np.arange(90) / 30])
    starts, ends = _steps(SimpleNamespace(frames=np.arange(91)), stamps_s)
    assert (stamps_s[ends] - stamps_s[starts]).round(1).tolist() == [1.0, 1.0]


def test_a_run_s_audit_is_not_to_be_trusted_then():
    sequence = replace(make_sequence(450, segment=None), T_world_cam=poses_of_sequence())
    record = execute(sequence, "base", 0, build=fake_factory(sequence))
    assert summarise(record)["audit"]["truth_fault"] == ""
    turned = with_rotations(sequence.T_world_cam, READ["OpenGL"])
    summary = summarise(replace(record, sequence=replace(sequence, T_world_cam=turned)))
    assert audit_text(summary).startswith(
        "audit by the truth: not to be trusted, as the true orientations fit"
    )
    assert "OpenGL" in summary["audit"]["truth_fault"]


def poses_of_sequence():
    """For 450 frames at the rate of the made-up sequence."""
    t = np.arange(450) / 30
    angles = 0.4 * np.sin(t[:, None] * (0.7, 1.1, 0.9) + (0, 1, 2))
    T = np.tile(np.eye(4), (450, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(angles).as_matrix()
    T[:, :3, 3] = np.column_stack([t, np.sin(t), 0.2 * t])
    return T
