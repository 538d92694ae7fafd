"""The arms of a unit: what is run over its frames, from one lead-in on.

Free: base and Dual-SLAM see the same images. Crossing: the map is saved at the onset and a new one is started
after the exposed segment, even if tracking would not have failed in it. Any other system, ours or not, runs
the free arm alone.

What units share is kept by :mod:`experiments.eq1.shared_runs`.
"""

from collections.abc import Sequence as Many
from dataclasses import dataclass, replace

import numpy as np

from dslab.experiments.eq1.branch_run import BranchRun, Saved
from dslab.experiments.eq1.shared_runs import SAVE_EVERY_S, forward_of, frames_key, kept, run_own
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined, align_poses
from dslab.experiments.evaluation.audit_report import audit_loss_in
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.ending import EndKind
from dslab.experiments.runs.execution import (
    Observer,
    RunRecord,
    execute,
    live_trajectories,
    slam_camera,
)
from dslab.experiments.runs.slam_settings import SlamSettings, factory_of
from dslab.experiments.runs.systems.class_process import run_class_apart
from dslab.experiments.runs.systems.command import CommandSystem, run_command
from dslab.experiments.runs.systems.command_spec import Limits
from dslab.experiments.runs.systems.framework import dual_builder
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.registry import DualSystem, OwnSystem, System, system_digest
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage, Event
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.dual.dual_slam import DualSlam

LEAD_IN_HEALTHY_S = 1.0
"""Time before the exposed segment for which the map must have been tracked without a gap."""
LEAD_IN_ERROR_SHARE = 0.05
"""Largest position error (RMS) on the lead-in, as a share of its path, of a healthy map."""
LIMITS = Limits()
"""What a class may take, as a program whose description does not say."""
PLAIN: dict[str, str] = {"dual+": "dual", "paper+": "paper"}
"""Systems beside which the base is that of another one, without its initialisation."""
_OURS_KEPT, _PROGRAMS_KEPT = 2, 16
"""Lead-ins that are kept; of ours, which are large, that of a system and a plain one beside it."""


# -- lead-in -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LeadIn:
    """A lead-in that leaves a healthy map.

    Attributes:
        saved: its end, from which arms resume.
        path: poses of the lead-in in its map.
    """

    saved: Saved
    path: MapTrajectory


_lead_ins: dict[str, LeadIn | str] = {}
_program_lead_ins: dict[str, tuple[RunRecord, str]] = {}


def lead_in_of(
    system: str, sequence: Sequence, onset: int, seed: int, settings: SlamSettings
) -> LeadIn | str:
    """The lead-in of one of our systems, or the reason why its map is not healthy at the onset.

    It is run now unless that of the same replicate in another cell is at hand.

    Args:
        system: name of the system.
        sequence: the frames of the unit.
        onset: first frame of the exposed segment.
        seed: of the system.
        settings: of the system.
    """
    key = frames_key(sequence, onset, [system, seed, repr(settings)])
    return kept(
        _lead_ins, _OURS_KEPT, key, lambda: _checked(run_lead_in(system, sequence, onset, seed, settings))
    )


def run_lead_in(
    system: str,
    sequence: Sequence,
    onset: int,
    seed: int,
    settings: SlamSettings,
    observer: Observer | None = None,
) -> BranchRun:
    """Run the frames before the onset, which all arms share; arguments as of :func:`lead_in_of`.

    Its arms, and those of the cells that share it, see most images again: their features are kept.
    """
    made = factory_of(settings)(system, slam_camera(sequence.camera), seed)
    made.engine.remember_features(2 * len(sequence))
    branch = BranchRun(made, sequence, observer=observer)
    branch.feed(onset)
    return branch


def _checked(branch: BranchRun) -> LeadIn | str:
    system = branch.system
    fault = lead_in_fault(branch.results, system.events, branch.sequence, branch.frames)
    keyframes = 0 if fault else len(system.current_map.keyframes())
    if not fault and keyframes <= system.config.min_map_keyframes:
        fault = f"{keyframes} keyframes only at the onset: a breakage would drop the map"
    if fault:
        return fault
    path = next(path for path in system.trajectories() if path.map_id == system.current_map_id)
    return LeadIn(branch.save(), path)


def lead_in_fault(results: Many[TrackingResult], events: Many[Event], sequence: Sequence, onset: int) -> str:
    """Reason why the map is not healthy at the onset; empty if it is healthy.

    Args:
        results: of the frames before the onset at least.
        events: of the same run.
        sequence: the input of the run.
        onset: first frame of the exposed segment.
    """
    before, truth = results[onset - 1], sequence.T_world_cam
    if not is_tracked(before):
        return "not tracking at the onset"
    if any(isinstance(e, Breakage) and e.frame < onset for e in events):
        return "broke in the lead-in"
    live = live_trajectories(results[:onset])[before.map_id]
    lead_s = before.stamp_s - live.stamps_s[0]
    if lead_s < LEAD_IN_HEALTHY_S:
        return f"tracked for {lead_s:.2f} s only before the onset"
    assert truth is not None  # it was rendered
    pairs = metrics.associate(live, sequence.stamps_s, truth)
    path_m = metrics.coverage(pairs.frames, truth).path_m
    alignment = align_poses(pairs.T_map_cam, pairs.T_world_cam)
    if isinstance(alignment, Undefined):
        return f"the lead-in cannot be judged: {alignment.reason}"
    error_m = metrics.rms(metrics.position_errors_m(pairs, alignment))
    if error_m > LEAD_IN_ERROR_SHARE * path_m:
        return f"position error {error_m:.3f} m on {path_m:.2f} m of lead-in"
    return ""


# -- arms ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FreeArm:
    """Result of the free arm.

    Attributes:
        base, dual: the two runs, from the first frame to the last.
        first_new_frame: see BranchRun, of the dual.
    """

    base: RunRecord
    dual: RunRecord
    first_new_frame: int | None


def run_free(
    lead_in: Saved, sequence: Sequence, system: str, seed: int, plain: Saved | None = None
) -> FreeArm:
    """Run base and Dual-SLAM to the end.

    Up to the first breakage the two are identical bit for bit and run as one; the base then resumes from a
    snapshot just before it. With a ``plain`` lead-in, of the system in ``PLAIN``, it resumes from that.
    """
    saved, stride = lead_in, max(1, round(SAVE_EVERY_S * sequence.camera.fps))
    dual = BranchRun.resume(lead_in, sequence)
    while not (dual.at_end or dual.is_broken):
        if dual.frames - saved.frames >= stride:
            saved = dual.save()
        dual.step()
    base = None
    if plain is not None or dual.is_broken:
        base = BranchRun.resume(plain or saved, sequence, as_base=True)
        base.run_out()
    dual.run_out()
    record = dual.record(system, seed)
    base_record = replace(record, system_kind="base") if base is None else base.record("base", seed)
    return FreeArm(base_record, record, dual.first_new_frame)


def run_crossing(lead_in: Saved, sequence: Sequence, end_frame: int) -> BranchRun:
    """Run every recovery thread over the whole exposed segment, even if tracking does not fail in it.

    The run ends as soon as a recovery has started and its threads have run. ``end_frame``: last of the
    segment.
    """
    branch = BranchRun.resume(lead_in, sequence)
    cross(branch, end_frame)
    while not (branch.at_end or branch.first_new_frame is not None):
        branch.step()
    branch.system.finish()
    return branch


def cross(branch: BranchRun, end_frame: int) -> None:
    """Save the map of a run at the onset, and begin a new one behind the last frame of the segment."""
    system = branch.system
    assert isinstance(system, DualSlam)
    system.cut()
    branch.feed(end_frame + 1)
    system.restart()


def run_other(
    system: System, sequence: Sequence, onset: int, seed: int, settings: SlamSettings
) -> tuple[RunRecord, str]:
    """Run a system without recovery threads: the base, DSO, or one of someone else's.

    A class or a program runs in a process of its own, so that a crash or a hang is its outcome; within
    Dual-SLAM over it a class does not. Whether the
    lead-in is healthy never depends on what comes after it. What gives poses frame by frame is judged by
    them. Of a program only what it leaves is known, which its end decides: its lead-in has a run of its own.

    Args:
        system: what to run.
        sequence: the frames of the unit.
        onset: first frame of the exposed segment.
        seed: of the system.
        settings: of ours.

    Returns:
        The record of the whole unit, or of the lead-in alone if that is at fault and the rest was not run;
        and why the lead-in is not healthy, empty if it is.
    """
    if isinstance(system, CommandSystem):

        def run_lead() -> tuple[RunRecord, str]:
            record = run_command(system, sequence.only(np.arange(onset)), seed)
            return record, _other_fault(record, onset)

        key = frames_key(sequence, onset, [system.name, system_digest(system), seed])
        record, fault = kept(_program_lead_ins, _PROGRAMS_KEPT, key, run_lead)
        return (record, fault) if fault else (run_command(system, sequence, seed), "")
    if isinstance(system, ClassSystem):
        record = run_class_apart(system, sequence, seed, LIMITS)
    elif isinstance(system, OwnSystem):
        record = run_own(system, sequence, onset, seed, settings)
    else:
        build = factory_of(settings)
        if isinstance(system, DualSystem):
            begun = forward_of(system, sequence, onset, seed, settings, whole=True)
            build = dual_builder(system, sequence, build, begun)
        record = execute(sequence, system.name, seed, build=build)
    return record, _other_fault(record, onset)


def _other_fault(record: RunRecord, onset: int) -> str:
    fault = lead_in_fault(record.results, record.events, record.sequence, onset)
    if not fault and len(record.results) > onset:
        # Only the poses before the onset decide whether a loss after it can be judged.
        judged = audit_loss_in(record, onset, onset)
        fault = f"a loss could not be judged: {judged.reason}" if isinstance(judged, Undefined) else ""
    elif fault and record.ending.kind is not EndKind.FINISHED:
        fault += f"; {record.ending.kind.value.replace('_', ' ')}: {record.ending.message}"
    return fault
