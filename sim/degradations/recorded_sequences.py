"""Degradations of recorded sequences, such as real footage."""

from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from scenarios.errors import InputError
from scenarios.segments import Segment, self_overlap
from sim.degradations.base import FramePlan, Stage, true_runs
from sim.degradations.chain import ImageChain
from sim.degradations.registry import FRAME_PLAN_KINDS, IMAGE_KINDS, in_order_of_action
from sim.degradations.truths import truths_of
from sim.io.raw import RawFrames, RawWriter
from sim.sequence import ChosenFrames, SegmentTruth, Sequence

_STAGES = (Stage.SCENE, Stage.READOUT, Stage.LENS, Stage.SENSOR, Stage.ENCODER)


class _NoMotion:
    """Stands in for an unknown motion."""

    def T_world_cam(self, stamp_s: float | np.ndarray) -> NoReturn:
        raise RuntimeError("the motion is not known")

    velocity_mps = rate_radps = T_world_cam


def recorded_sequence_kinds(depth: bool) -> list[str]:
    """Kinds that need no world and, unless ``depth``, no depth images."""
    timing = [kind for kind, d in FRAME_PLAN_KINDS.items() if d.stage is Stage.TIMING]
    images = [kind for kind, d in IMAGE_KINDS.items() if not d.needs_motion and (depth or not d.needs_depth)]
    return timing + images


def check_recorded_sequence(sequence: Sequence, segments: Many[Segment]) -> None:
    """Check that segments can act on a recorded sequence.

    Raises:
        InputError: a kind needs what the sequence lacks, a segment ends after it, or two overlap.
    """
    kinds = recorded_sequence_kinds(sequence.depths is not None)
    length_s = float(sequence.stamps_s[-1] - sequence.stamps_s[0]) + 1 / sequence.camera.fps
    for segment in segments:
        if segment.kind not in kinds:
            lacking = (
                "a folder with depth images" if segment.kind in recorded_sequence_kinds(True) else "a world"
            )
            problem = f"{segment.kind} needs {lacking}"
            raise InputError(sequence.name, problem, f"use one of {', '.join(kinds)}")
        if segment.end_s > length_s + 1e-6:
            problem = f"{segment.label}, ends after the sequence"
            raise InputError(sequence.name, problem, f"end it by {length_s:g} s after the first frame")
    clash = self_overlap(segments)
    if clash:
        first, second = (
            f"{segments[i].kind} ({segments[i].start_s:g}-{segments[i].end_s:g} s)" for i in clash
        )
        problem = f"{first} and {second} are of one kind and overlap"
        raise InputError(sequence.name, problem, "start one when the other has ended")


def degrade_sequence(
    sequence: Sequence,
    segments: Many[Segment],
    seed: int,
    scratch: Path,
    progress: Callable[[str, int, int], None] | None = None,
) -> Sequence:
    """Apply segments to a sequence; their times count from the first frame.

    Its poses, its depth and its earlier segments stay.

    Args:
        sequence: any; its frames are read one by one.
        segments: of the kinds of ``recorded_sequence_kinds``.
        seed: root seed of their random draws.
        scratch: folder for the frames, to be kept as long as the result is used.
        progress: called after every frame.

    Raises:
        InputError: as ``check_recorded_sequence``, or a frame cannot be read.
    """
    check_recorded_sequence(sequence, segments)
    plan = _plan(sequence, segments, seed)
    known_s = sequence.frame_truth.get("exposure_s")
    exposure_s = None if known_s is None else known_s[plan.frame]
    chain = ImageChain(segments, sequence.camera, plan.stamps_s, plan.frame, seed, exposure_s=exposure_s)
    size = (sequence.camera.height_px, sequence.camera.width_px)
    with RawWriter(scratch / "gray.npy", (len(plan.frame), *size), np.uint8) as grays:
        for index, frame in enumerate(plan.frame.tolist()):
            depth_m = sequence.depths[frame] if sequence.depths is not None else None
            grays.append(chain.apply(sequence.frames[frame], index, _STAGES, depth_m))
            if progress:
                progress("degrading", index + 1, len(plan.frame))
    truths, columns = _truths(sequence, segments, plan, chain)
    kept = plan.frame
    return replace(
        sequence,
        stamps_s=sequence.stamps_s[kept] + plan.stamp_error_s,
        frames=RawFrames(scratch / "gray.npy", (len(kept), *size), np.uint8),
        T_world_cam=None if sequence.T_world_cam is None else sequence.T_world_cam[kept],
        depths=None if sequence.depths is None else ChosenFrames(sequence.depths, kept),
        segments=truths,
        meta={
            **sequence.meta,
            "degraded": {"segments": [segment.model_dump(mode="json") for segment in segments], "seed": seed},
        },
        frame_truth=columns,
    )


def _plan(sequence: Sequence, segments: Many[Segment], seed: int) -> FramePlan:
    """The frame plan of the sequence, with the segments' effects on frames and stamps."""
    stamps_s = sequence.stamps_s - sequence.stamps_s[0]
    count = len(stamps_s)
    plan = FramePlan(
        stamps_s, _NoMotion(), np.zeros(count), np.empty(0), np.zeros((count, 0), np.float32), seed
    )
    for segment in in_order_of_action(segments):
        if segment.kind in FRAME_PLAN_KINDS:
            plan = FRAME_PLAN_KINDS[segment.kind].apply(plan, segment)
    return plan


def _truths(
    sequence: Sequence, segments: Many[Segment], plan: FramePlan, chain: ImageChain
) -> tuple[tuple[SegmentTruth, ...], dict[str, np.ndarray]]:
    """Truths of the earlier and the new segments, and the columns of both."""
    truths = [_renumbered(truth, plan.frame) for truth in sequence.segments]
    columns = {name: values[plan.frame] for name, values in sequence.frame_truth.items()}
    added, measured = truths_of(segments, plan, chain, np.zeros(len(plan.frame)))
    for name, measure in measured.items():
        columns[name] = np.maximum(columns.get(name, 0.0), measure)
    return (*truths, *added), columns


def _renumbered(truth: SegmentTruth, kept: np.ndarray) -> SegmentTruth:
    """The truth in numbers of the kept frames."""
    acts = truth.mask(int(kept[-1]) + 1)[kept]
    runs = true_runs(acts, acts)
    first, last = (runs[0][0], runs[-1][1]) if runs else (-1, -1)
    return replace(truth, first_frame=first, last_frame=last, runs=runs)
