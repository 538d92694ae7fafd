"""Sheet of one scenario with one seed: plain data and picture files."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dslab.experiments.gallery.plan_map import draw_map
from dslab.scenarios.describe import describe_camera, describe_motion, describe_world, measured
from dslab.scenarios.segments import SegmentBase
from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan
from dslab.sim.motion.base import Motion
from dslab.sim.preview import Preview, preview

_THUMB_PIXELS, _QUALITY = 60_000, 80
_MEASURE_STEP_S = 0.01
_SEGMENT_POINTS = 24


@dataclass(frozen=True)
class Thumb:
    """Thumbnail of one frame.

    Attributes:
        file: path of the thumbnail, relative to the gallery.
        width_px, height_px: size of the thumbnail.
        frame: index in the sequence.
        stamp_s: true time of the frame.
        segment: index of the scenario's segment at this time, None for a clean frame.
        blur_px: median length of motion blur.
    """

    file: str
    width_px: int
    height_px: int
    frame: int
    stamp_s: float
    segment: int | None
    blur_px: float


@dataclass(frozen=True)
class Sheet:
    """One scenario with one seed.

    Attributes:
        scenario: the sampled scenario.
        thumbs: thumbnails in time order.
        map_file: map of the path, relative to the gallery.
        facts: about the sequence, by name.
    """

    scenario: Scenario
    thumbs: tuple[Thumb, ...]
    map_file: str
    facts: dict[str, str]


def make_sheet(scenario: Scenario, frames: int, folder: Path) -> Sheet:
    """Plan a sequence, render some frames, write thumbnails and map.

    Args:
        scenario: the scenario with its seed.
        frames: number of frames, at least one per segment.
        folder: folder of the gallery; pictures go into a folder inside it.

    Raises:
        InputError: no GL, or impossible sizes of the world.
    """
    look = preview(scenario)
    motion = look.plan.motion
    pictures = f"pictures/{scenario.name.replace('/', '.')}/seed-{scenario.seed}"
    (folder / pictures).mkdir(parents=True)
    thumbs = _thumbs(look, frames, folder, pictures)
    stamps_s = np.linspace(0, scenario.duration_s, max(2, round(scenario.duration_s / _MEASURE_STEP_S)))
    position_m = motion.T_world_cam(stamps_s)[:, :3, 3]
    spans_s = [np.linspace(s.start_s, s.end_s, _SEGMENT_POINTS) for s in scenario.segments]
    segments_m = [
        (s.kind, motion.T_world_cam(span_s)[:, :3, 3])
        for s, span_s in zip(scenario.segments, spans_s, strict=True)
    ]
    T_world_cam = motion.T_world_cam(np.array([thumb.stamp_s for thumb in thumbs]))
    map_file = f"{pictures}/map.png"
    draw_map(
        folder / map_file, look.world, position_m, segments_m, T_world_cam[:, :3, 3], T_world_cam[:, :3, 2]
    )
    facts = _facts(scenario, motion, stamps_s, position_m)
    facts["duration"] = f"{scenario.duration_s:g} s, {len(look.plan.stamps_s)} frames"
    return Sheet(scenario, thumbs, map_file, facts)


def chosen_frames(plan: FramePlan, segments: tuple[SegmentBase, ...], count: int) -> list[int]:
    """Choose frames spread over a sequence, with the middle of every segment, increasing.

    Args:
        plan: the frame plan.
        segments: segments of the scenario; one between two frames has no frame.
        count: number of frames, at least one per segment.
    """
    middles = set()
    for segment in segments:
        inside = np.flatnonzero(plan.within(segment))
        if len(inside):
            from_middle_s = np.abs(plan.stamps_s[inside] - (segment.start_s + segment.end_s) / 2)
            middles.add(int(inside[np.argmin(from_middle_s)]))
    spread = np.unique(np.linspace(0, len(plan.stamps_s) - 1, count).round().astype(int)).tolist()
    # Each middle replaces the nearest frame of the even spread.
    for middle in sorted(middles):
        if spread:
            spread.remove(min(spread, key=lambda frame: abs(frame - middle)))
    return sorted(middles.union(spread))


def _thumbs(look: Preview, count: int, folder: Path, pictures: str) -> tuple[Thumb, ...]:
    segments, plan = look.scenario.segments, look.plan
    chosen = chosen_frames(plan, segments, count)
    images, blur_px, _ = look.expose_frames(chosen)
    thumbs = []
    for place, (frame, image) in enumerate(zip(chosen, images, strict=True)):
        scale = min(1.0, np.sqrt(_THUMB_PIXELS / image.size))
        width_px, height_px = (max(1, round(side * scale)) for side in image.shape[::-1])
        small = cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA)
        file = f"{pictures}/frame-{place + 1:02}.jpg"
        # Python raises on a write error where OpenCV only returns False.
        encoded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        (folder / file).write_bytes(encoded.tobytes())
        within = next((k for k, s in enumerate(segments) if plan.within(s)[frame]), None)
        stamp_s = float(plan.stamps_s[frame])
        thumbs.append(Thumb(file, width_px, height_px, frame, stamp_s, within, float(blur_px[place])))
    return tuple(thumbs)


def _facts(
    scenario: Scenario, motion: Motion, stamps_s: np.ndarray, position_m: np.ndarray
) -> dict[str, str]:
    speed_mps = np.linalg.norm(motion.velocity_mps(stamps_s), axis=1).max()
    rate_degps = np.rad2deg(np.linalg.norm(motion.rate_radps(stamps_s), axis=1)).max()
    length_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1).sum()
    return {
        "world": describe_world(scenario),
        "motion": describe_motion(scenario),
        "camera": describe_camera(scenario),
        "path": f"{measured(length_m)} m, up and down by {measured(np.ptp(position_m[:, 2]))} m",
        "fastest": f"{measured(speed_mps)} m/s, {measured(rate_degps)} °/s",
    }
