"""A run is judged against the truth all along: wrong stretches, bent maps, and where nothing can be told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slam_fakes import circle, fake_factory, make_sequence

from dslab.experiments.evaluation.audit import AuditBounds
from dslab.experiments.evaluation.audit_text import audit_text, runs_text
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.path_audit import audit_path
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs.execution import execute
from dslab.slam.core.events import LoopClosed
from dslab.slam.core.results import MapTrajectory

FPS = 30


def run(truth=None, kind="base", frames=450, **script):
    """A run over a recording, of which no segment is known; the truth may be less than what is replayed."""
    sequence = make_sequence(frames, segment=None)
    record = execute(sequence, kind, 0, build=fake_factory(sequence, **script))
    return record if truth is None else replace(record, sequence=replace(sequence, T_world_cam=truth))


def judged(*args, **script):
    return summarise(run(*args, **script))


def path_of(T) -> MapTrajectory:
    return MapTrajectory(0, np.arange(len(T)), np.arange(len(T)) / FPS, T)


def wrong(T, truth):
    return audit_path(path_of(T), Truth(np.arange(len(T)) / FPS, truth), AuditBounds()).wrong


def test_a_good_run_is_judged_throughout_and_said_to_be_good():
    summary = judged(noise_m=0.01)
    assert summary["audit"]["losses"] == []
    assert summary["audit"]["live"] == {"poses": 445, "judged": 445, "reason": ""}
    assert audit_text(summary).endswith("no declared losses; no silent losses; no corrupted maps")


def test_a_path_that_departs_from_the_truth_is_a_silent_loss_with_its_onset():
    summary = judged(drift_from=260)
    (loss,) = summary["audit"]["losses"]
    assert 260 < loss["true_loss_frame"] <= 270 and loss["silent"] is True and loss["segment"] is None
    (found,) = summary["audit"]["maps"]
    assert found["corrupted"] is True and 260 < found["first_frame"] <= 270
    onset = f"{loss['true_loss_frame'] / FPS:.2f} s"
    assert f"1 silent loss (from {onset} on); map 0 corrupted, bent at" in audit_text(summary)


def test_a_departure_that_ends_in_a_breakage_is_declared_as_late_as_it_is():
    summary = judged(drift_from=200, breaks_at=340)
    (loss,) = summary["audit"]["losses"]
    assert 200 < loss["true_loss_frame"] <= 210 and loss["silent"] is False
    assert loss["delay_s"] == pytest.approx((340 - loss["true_loss_frame"]) / FPS)


def test_a_map_that_bends_slowly_is_corrupted_though_no_stretch_of_it_is_wrong():
    """Straight on for 160 s at 1 m/s, in which lengths fall to a seventh: by 6 % in five seconds."""
    time_s = np.arange(1600) / 10
    truth = np.tile(np.eye(4), (1600, 1, 1))
    truth[:, 0, 3] = time_s
    T = truth.copy()
    T[:, 0, 3] = 80 * (1 - np.exp(-time_s / 80))
    sequence = replace(make_sequence(1600, segment=None), T_world_cam=truth, stamps_s=time_s)
    bent = replace(sequence, T_world_cam=T)
    summary = summarise(execute(sequence, "base", 0, build=fake_factory(bent)))
    (found,) = summary["audit"]["maps"]
    assert (found["corrupted"], found["first_frame"]) == (True, None)
    assert found["error_m"] > 0.05 * found["path_m"]
    text = audit_text(summary)
    assert "no silent losses; map 0 corrupted (" in text and f"{found['error_m']:.2f} m" in text


def test_a_path_that_never_follows_the_true_one_is_wrong_from_its_start():
    T = circle(450)
    T[:, :3, 3] = np.random.default_rng(0).normal(0, 1, (450, 3))
    assert wrong(T, circle(450))[0][0] == 0


def test_a_correction_of_the_map_is_no_loss():
    record = run()
    T = record.live[0].T_map_cam.copy()
    T[record.live[0].frames >= 250, :3, 3] += 1.0
    jumped = replace(record, live={0: replace(record.live[0], T_map_cam=T)})
    assert [x["true_loss_frame"] for x in summarise(jumped)["audit"]["losses"]] == [250]
    closed = LoopClosed(
        frame=250, stamp_s=250 / FPS, map_id=0, keyframe=240, loop_keyframe=20, scale=1, matches=9, cpu_ms=0
    )
    assert summarise(replace(jumped, events=(*record.events, closed)))["audit"]["losses"] == []


# -- what is no loss, and what is not judged ---------------------------------------------------------------


@pytest.mark.parametrize("first", [200, 290])
def test_poses_that_are_off_for_a_moment_are_no_loss(first):
    T = circle(450)
    T[first : first + 25, 2, 3] += 1.0  # also where the first window ends, at 300
    assert wrong(T, circle(450)) == ()


def test_poses_that_lie_right_in_the_path_as_a_whole_are_right():
    truth = circle(600)
    T = truth.copy()
    for half, turn_deg in ((slice(0, 300), 3.0), (slice(300, 600), -3.0)):
        T[half, :3, :3] = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix() @ T[half, :3, :3]
    assert wrong(T, truth) == ()
    T[300:, :3, :3] = Rotation.from_euler("z", -5, degrees=True).as_matrix() @ T[300:, :3, :3]
    assert wrong(T, truth)[0][0] == 300


@pytest.mark.parametrize("truth_off_m", [0.0, 0.04])
def test_a_scale_from_poses_of_a_small_extent_is_as_uncertain_as_they_are_off(truth_off_m):
    """Five seconds of 40 cm, then a walk; if the truth sways there, the scale of these poses says nothing."""
    time_s = np.arange(600) / 10
    T = np.tile(np.eye(4), (600, 1, 1))
    T[:, 0, 3] = np.where(time_s < 5, 0.08 * time_s, 0.4 + time_s - 5)
    truth, away = T.copy(), time_s >= 5
    T[away, 0, 3] = 0.4 + 120 * (1 - np.exp(-(time_s[away] - 5) / 120))  # a slow drift, none by itself
    T[~away, 0, 3] *= 1.0 if truth_off_m else 0.8
    truth[~away, 0, 3] += truth_off_m * np.sin(2 * np.pi * time_s[~away] / 5)
    found = audit_path(MapTrajectory(0, np.arange(600), time_s, T), Truth(time_s, truth), AuditBounds())
    assert bool(found.wrong) is (truth_off_m == 0)


def test_gaps_of_the_truth_are_not_judged_across():
    truth = circle(900)
    truth[350:440] = np.nan
    T = circle(900)
    T[400:, :3, 3] += 2.0
    found = audit_path(path_of(T), Truth(np.arange(900) / FPS, truth), AuditBounds())
    assert found.wrong == () and len(found.judged) == 810
    assert set(found.unjudged.values()) == {"no true pose"}


def test_a_truth_of_fewer_frames_than_the_camera_hides_no_loss():
    truth, T = circle(300), circle(300)
    truth[1::2] = np.nan
    T[170:, 2, 3] += 1.0
    assert wrong(T, truth)[0][0] == 170


def one_frame():
    truth = np.full((450, 4, 4), np.nan)
    truth[100] = np.eye(4)
    return truth


@pytest.mark.parametrize(
    ("truth", "script", "why"),
    [
        (one_frame(), {}, "no true pose"),
        (np.tile(np.eye(4), (450, 1, 1)), {}, "0.00 m of path"),
        (None, {"starts_at": 10_000}, "no pose was given"),
    ],
)
def test_what_cannot_be_judged_was_not_looked_for(truth, script, why):
    text = audit_text(judged(truth, **script))
    assert "no silent losses" not in text and "no corrupted maps" not in text
    assert f"silent losses and corrupted maps not looked for: {why}" in text


def test_without_truth_nothing_was_looked_for():
    record = run()
    text = audit_text(summarise(replace(record, sequence=replace(record.sequence, T_world_cam=None))))
    assert text == "audit by the truth: nothing looked for: no ground truth"


def test_of_a_part_it_is_said_which_and_of_several_runs_how_many():
    truth = circle(450)
    truth[225:] = np.nan
    part, lost = judged(truth), judged(drift_from=260)
    assert "no silent losses, not looked for in 51 % of the live poses (no true pose)" in audit_text(part)
    assert runs_text([part, lost, part | {"audit": None}]) == (
        "audit by the truth, of 3 runs: silent losses in 1, corrupted maps in 1, not looked for in 1"
    )
    assert runs_text([lost]) == audit_text(lost)
