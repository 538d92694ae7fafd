"""Degradations of recorded sequences, such as real footage."""

from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import replace
from pathlib import Path

import numpy as np

from dslab.scenarios.segments import LowTexture, Segment
from dslab.sim.degradations.base import FramePlan, Stage, during
from dslab.sim.degradations.recorded_kinds import check_recorded_sequence, view_of
from dslab.sim.degradations.registry import FRAME_PLAN_KINDS, in_order_of_action
from dslab.sim.degradations.retake import Retake, fill_narrow_holes
from dslab.sim.degradations.segment_link import segment_links
from dslab.sim.degradations.truth import truths_of
from dslab.sim.io.raw import RawFrames, RawWriter
from dslab.sim.link import USUAL_EXPOSURE_S, View, fold
from dslab.sim.sequence import Sequence


class _AsRecorded:
    """The motion of the recorded camera, seen from itself: what segments add to it is all there is."""

    def T_world_cam(self, stamp_s: float | np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.eye(4), (*np.shape(stamp_s), 4, 4))

    def velocity_mps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        return np.zeros((*np.shape(stamp_s), 3))

    rate_radps = velocity_mps


def degrade_sequence(
    sequence: Sequence,
    segments: Many[Segment],
    seed: int,
    scratch: Path,
    progress: Callable[[str, int, int], None] | None = None,
) -> Sequence:
    """Apply segments to a sequence; their times count from the first frame.

    Its earlier segments stay. So do its poses and its depth, unless the camera turns: they turn with it, and
    every frame is cropped to what all turns see (``TurnedView``). See ``Retake`` for the kinds that would
    act before a frame is rendered. Narrow holes of measured depth images count as filled.

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
    view = view_of(sequence.camera, segments)
    assert view.camera is not None
    whole, plan = _plans(sequence, segments, seed)
    own_s = _own_exposure_s(sequence)
    retake = Retake(sequence, replace(whole, exposure_s=whole.exposure_s - own_s), view)
    known = "exposure_s" in sequence.frame_truth
    exposure_s = plan.exposure_s if known else np.maximum(plan.exposure_s, USUAL_EXPOSURE_S)
    links = segment_links(segments, view.camera, plan.stamps_s, seed)
    size, blur_px = (view.camera.height_px, view.camera.width_px), np.zeros(len(plan.frame))
    exact_depth = "spec" in sequence.meta
    with RawWriter(scratch / "gray.npy", (len(plan.frame), *size), np.uint8) as grays:
        for index, frame in enumerate(plan.frame.tolist()):
            image, blur_px[index] = retake.image(frame)
            depth_m = retake.depth(frame)
            if depth_m is not None and not exact_depth:
                depth_m = fill_narrow_holes(depth_m, view.camera)
            stamp_s, open_s = float(plan.stamps_s[index]), float(exposure_s[index])
            taken = View(frame, stamp_s, depth_m=depth_m, exposure_s=open_s, index=index)
            grays.append(fold(links, image, taken)[0])
            if progress:
                progress("degrading", index + 1, len(plan.frame))
    left = sequence.only(plan.frame)
    added, columns = truths_of(segments, plan, links, blur_px)
    columns = {
        **left.frame_truth,
        **{n: np.maximum(left.frame_truth.get(n, 0.0), m) for n, m in columns.items()},
    }
    if "exposure_s" in columns:
        columns["exposure_s"] = plan.exposure_s
    degraded = {"segments": [segment.model_dump(mode="json") for segment in segments], "seed": seed}
    if view.camera != sequence.camera:
        degraded["window_px"] = {"left": view.left, "top": view.top}
    turns = plan.motion.T_world_cam(plan.stamps_s)
    return replace(
        left,
        camera=view.camera,
        stamps_s=left.stamps_s + plan.stamp_error_s,
        frames=RawFrames(scratch / "gray.npy", (len(plan.frame), *size), np.uint8),
        T_world_cam=None if left.T_world_cam is None else left.T_world_cam @ turns,
        depths=None if sequence.depths is None else _RetakenDepths(retake, plan.frame),
        segments=(*left.segments, *added),
        meta={**sequence.meta, "degraded": degraded},
        frame_truth=columns,
    )


class _RetakenDepths:
    """The depth images of the kept frames of a retake."""

    def __init__(self, retake: Retake, kept: np.ndarray) -> None:
        self._retake, self._kept = retake, kept

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, index: int) -> np.ndarray:
        depth_m = self._retake.depth(int(self._kept[index]))
        assert depth_m is not None
        return depth_m


def _plans(sequence: Sequence, segments: Many[Segment], seed: int) -> tuple[FramePlan, FramePlan]:
    """The plan of all frames, and that of those that are not dropped, with their stamps."""
    stamps_s = sequence.stamps_s - sequence.stamps_s[0]
    count = len(stamps_s)
    # Where no surfaces are known, one stands for all that is seen during a segment of low texture.
    shares = [during(segment, stamps_s) for segment in segments if isinstance(segment, LowTexture)]
    view_share = np.array(shares, np.float32).reshape(-1, count).T
    own_s = _own_exposure_s(sequence)
    plan = FramePlan(stamps_s, _AsRecorded(), own_s, np.ones(len(shares)), view_share, seed)
    whole = plan
    for segment in in_order_of_action(segments):
        if segment.kind in FRAME_PLAN_KINDS:
            plan = FRAME_PLAN_KINDS[segment.kind].apply(plan, segment)
            # A shutter cannot be open for less time than it was.
            plan = replace(plan, exposure_s=np.maximum(plan.exposure_s, own_s[plan.frame]))
            whole = plan if FRAME_PLAN_KINDS[segment.kind].stage < Stage.TIMING else whole
    return whole, plan


def _own_exposure_s(sequence: Sequence) -> np.ndarray:
    """(N,) shutter time of the recording, 0 where unknown."""
    return sequence.frame_truth.get("exposure_s", np.zeros(len(sequence)))
