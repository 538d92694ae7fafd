"""Degradations of recorded sequences, such as real footage."""

from collections.abc import Callable
from collections.abc import Sequence as Many
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from dslab.scenarios.segments import LowTexture, Segment
from dslab.sim.degradations.base import FramePlan, Stage, during
from dslab.sim.degradations.recorded_kinds import check_recorded_sequence, view_of
from dslab.sim.degradations.registry import FRAME_PLAN_KINDS, in_order_of_action
from dslab.sim.degradations.retake import Retake, fill_narrow_holes
from dslab.sim.degradations.segment_link import segment_links
from dslab.sim.degradations.truth import truths_of
from dslab.sim.degradations.turned_view import TurnedView
from dslab.sim.io.raw import RawFrames, RawWriter
from dslab.sim.link import USUAL_EXPOSURE_S, View, fold
from dslab.sim.sequence import FrameSource, InColour, Sequence


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
    colour: bool = True,
) -> Sequence:
    """Apply segments to a sequence; their times count from the first frame.

    Its earlier segments stay. So do its poses and its depth, unless the camera turns: they turn with it, and
    every frame is cropped to what all turns see (``TurnedView``). See ``Retake`` for the kinds that would
    act before a frame is rendered. Narrow holes of measured depth images count as filled.

    Frames in colour are degraded in colour, each channel as the light that it is, and made gray thereafter;
    frames that nothing changes keep their gray levels.

    Args:
        sequence: any; its frames are read one by one.
        segments: of the kinds of ``recorded_sequence_kinds``.
        seed: root seed of their random draws.
        scratch: folder for the frames, to be kept as long as the result is used.
        progress: called after every frame.
        colour: keep the frames in colour too, where the sequence has it, which takes four times the space.

    Raises:
        InputError: as ``check_recorded_sequence``, or a frame cannot be read.
    """
    check_recorded_sequence(sequence, segments)
    view = view_of(sequence.camera, segments)
    assert view.camera is not None
    whole, plan = _plans(sequence, segments, seed)
    own_s = _own_exposure_s(sequence)
    shown = InColour(sequence.frames)
    retake = Retake(sequence, replace(whole, exposure_s=whole.exposure_s - own_s), view, shown)
    known = "exposure_s" in sequence.frame_truth
    exposure_s = plan.exposure_s if known else np.maximum(plan.exposure_s, USUAL_EXPOSURE_S)
    links = segment_links(segments, view.camera, plan.stamps_s, seed)
    shape = (len(plan.frame), view.camera.height_px, view.camera.width_px)
    colour, blur_px = colour and shown.is_coloured, np.zeros(len(plan.frame))
    stacks = {"gray.npy": shape} | ({"colour.npy": (*shape, 3)} if colour else {})
    exact_depth = "spec" in sequence.meta
    with ExitStack() as open_files:
        grays, *colours = (
            open_files.enter_context(RawWriter(scratch / name, stack, np.uint8))
            for name, stack in stacks.items()
        )
        for index, frame in enumerate(plan.frame.tolist()):
            image, blur_px[index] = retake.image(frame)
            depth_m = retake.depth(frame)
            if depth_m is not None and not exact_depth:
                depth_m = fill_narrow_holes(depth_m, view.camera)
            stamp_s, open_s = float(plan.stamps_s[index]), float(exposure_s[index])
            taken = View(frame, stamp_s, depth_m=depth_m, exposure_s=open_s, index=index)
            image = fold(links, image, taken)[0]
            grays.append(_gray(image, retake, sequence, frame, view) if shown.is_coloured else image)
            for stack in colours:
                stack.append(image)
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
        frames=_Degraded(*(RawFrames(scratch / name, stack, np.uint8) for name, stack in stacks.items())),
        T_world_cam=None if left.T_world_cam is None else left.T_world_cam @ turns,
        depths=None if sequence.depths is None else _RetakenDepths(retake, plan.frame),
        segments=(*left.segments, *added),
        meta={**sequence.meta, "degraded": degraded},
        frame_truth=columns,
    )


def _gray(image: np.ndarray, retake: Retake, sequence: Sequence, frame: int, view: TurnedView) -> np.ndarray:
    """(h, w) uint8 gray of a degraded frame: the recording's own where nothing changed, else as if read."""
    if np.array_equal(image, view.crop(retake.recorded(frame))):
        return view.crop(sequence.frames[frame])
    # Decoders weigh colours each in its way: this is how the written folder will be read.
    encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 0])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE))


class _Degraded:
    """Degraded frames, in gray and, if kept, in colour."""

    def __init__(self, grays: FrameSource, colours: FrameSource | None = None) -> None:
        self._grays = grays
        if colours is not None:
            self.colour = colours.__getitem__

    def __len__(self) -> int:
        return len(self._grays)

    def __getitem__(self, index: int) -> np.ndarray:
        return self._grays[index]


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
