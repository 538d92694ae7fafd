"""Which kinds of degradation act on recorded sequences, and whether given segments can."""

from collections.abc import Sequence as Many

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.scenarios.segments import FastRotation, MotionBlur, Segment, self_overlap
from dslab.sim.degradations.base import Stage, during
from dslab.sim.degradations.registry import DEGRADATIONS, IMAGE_KINDS
from dslab.sim.degradations.rotation import swing_angle_rad, swing_axis
from dslab.sim.degradations.turned_view import TurnedView
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence

# Kinds of the frame plan that a retake can stand in for.
RETAKEN = ("fast_rotation", "low_texture", "motion_blur")
_DEPTH, _WORLD = "a folder with depth images", "a world"
_TURN_STEPS, _SEARCH_STEPS = 9, 8
# The flow cannot bridge more missing frames.
_LONGEST_GAP = 3.0


def recording_lacks(kind: str) -> str:
    """What a kind needs besides the frames of a recording; empty for nothing."""
    degradation = DEGRADATIONS[kind]
    if kind in IMAGE_KINDS:
        if IMAGE_KINDS[kind].needs_motion:
            return _WORLD
        return _DEPTH if IMAGE_KINDS[kind].needs_depth else ""
    return "" if kind in RETAKEN or degradation.stage is Stage.TIMING else _WORLD


def recorded_sequence_kinds(depth: bool) -> list[str]:
    """Kinds that act on a recorded sequence, in their order of action.

    Args:
        depth: the sequence has depth images.
    """
    enough = ("", _DEPTH) if depth else ("",)
    return [kind for kind in DEGRADATIONS if recording_lacks(kind) in enough]


def view_of(camera: Intrinsics, segments: Many[Segment], share: float = 1.0) -> TurnedView:
    """The window that remains of a recording whose camera is turned by segments.

    Args:
        camera: of the recording.
        segments: any.
        share: of their angles.
    """
    angles = [
        swing_axis(segment) * swing_angle_rad(segment) * share * step
        for segment in segments
        if isinstance(segment, FastRotation)
        for step in np.linspace(0, 1, _TURN_STEPS)
    ]
    return TurnedView(camera, Rotation.from_rotvec(angles).as_matrix() if angles else None)


def check_recorded_sequence(sequence: Sequence, segments: Many[Segment]) -> None:
    """Check that segments can act on a recorded sequence.

    Raises:
        InputError: a kind needs what the sequence lacks, a segment ends after it, two of a kind overlap, a
            turn leaves too little of the frames, or a shutter is open while there are no frames.
    """
    kinds = recorded_sequence_kinds(sequence.depths is not None)
    stamps_s = sequence.stamps_s - sequence.stamps_s[0]
    length_s = float(stamps_s[-1]) + 1 / sequence.camera.fps
    for segment in segments:
        if segment.kind not in kinds:
            problem = f"{segment.kind} needs {recording_lacks(segment.kind)}"
            raise InputError(sequence.name, problem, f"use one of {', '.join(kinds)}")
        if segment.end_s > length_s + 1e-6:
            problem = f"{segment.label}, ends after the sequence"
            raise InputError(sequence.name, problem, f"end it by {length_s:g} s after the first frame")
        if isinstance(segment, MotionBlur):
            _check_shutter(sequence.name, segment, stamps_s)
    clash = self_overlap(segments)
    if clash:
        first, second = (
            f"{segments[i].kind} ({segments[i].start_s:g}-{segments[i].end_s:g} s)" for i in clash
        )
        problem = f"{first} and {second} are of one kind and overlap"
        raise InputError(sequence.name, problem, "start one when the other has ended")
    _check_turns(sequence, segments)


def _check_shutter(name: str, segment: MotionBlur, stamps_s: np.ndarray) -> None:
    """Check that there are frames as long as the shutter is open."""
    blurred = stamps_s[during(segment, stamps_s)]
    if not len(blurred) or segment.exposure_s == 0:
        return
    half_s, last_s = segment.exposure_s / 2, float(stamps_s[-1])
    if segment.exposure_s > last_s:
        problem = f"{segment.label}: exposure_s = {segment.exposure_s:g} is longer than the sequence"
        raise InputError(name, problem, f"use less than {last_s:g}")
    if blurred[0] - half_s < -1e-9:
        problem = f"{segment.label}: the shutter would be open before the first frame"
        raise InputError(name, problem, f"start it at {half_s:g} s or later")
    if blurred[-1] + half_s > last_s + 1e-9:
        problem = f"{segment.label}: the shutter would be open after the last frame"
        raise InputError(name, problem, f"end it by {last_s - half_s:g} s")
    intervals_s = np.diff(stamps_s)
    gaps = np.flatnonzero(intervals_s > _LONGEST_GAP * np.median(intervals_s))
    for begin_s, end_s in zip(stamps_s[gaps], stamps_s[gaps + 1], strict=True):
        if begin_s < blurred[-1] + half_s and end_s > blurred[0] - half_s:
            problem = (
                f"{segment.label}: there are no frames from {begin_s:.3f} to {end_s:.3f} s to blur between"
            )
            raise InputError(name, problem, "choose another time")


def _check_turns(sequence: Sequence, segments: Many[Segment]) -> None:
    """Check that enough is left of the frames under the greatest turn."""
    if view_of(sequence.camera, segments).camera is not None:
        return
    least, most = 0.0, 1.0
    for _ in range(_SEARCH_STEPS):
        middle = (least + most) / 2
        fits = view_of(sequence.camera, segments, middle).camera is not None
        least, most = (middle, most) if fits else (least, middle)
    turns = [segment for segment in segments if isinstance(segment, FastRotation)]
    widest = max(turns, key=swing_angle_rad)
    problem = (
        f"{widest.label}: a turn of {np.degrees(swing_angle_rad(widest)):.1f} degrees leaves less than half "
        "of the frame's width or height"
    )
    remedy = f"use rate_degps = {np.floor(least * widest.rate_degps * 10) / 10:g}, or a shorter duration_s"
    raise InputError(sequence.name, problem, remedy)
