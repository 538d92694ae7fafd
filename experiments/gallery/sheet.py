"""Sheet of one scenario with one seed: plain data and picture files."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dslab.experiments.gallery.outline import MapFrame, draw_outline, frame_of
from dslab.scenarios.segments import SegmentBase
from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan
from dslab.sim.motion.base import Motion
from dslab.sim.preview import Preview, preview
from dslab.sim.sequence_rendering import RenderBackend

THUMB_PIXELS = 60_000
"""Pixels of a thumbnail of any shape."""

_QUALITY = 80
_MEASURE_STEP_S = 0.01
_TRACK_POINTS, _SEGMENT_POINTS = 1000, 24


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
        position_m: (3,) position of the camera.
        gaze: (2,) optical axis from above, shorter than 1 if the camera looks up or down.
    """

    file: str
    width_px: int
    height_px: int
    frame: int
    stamp_s: float
    segment: int | None
    blur_px: float
    position_m: np.ndarray
    gaze: np.ndarray


@dataclass(frozen=True)
class Track:
    """True motion of the camera, including moving segments, thinned for drawing.

    Attributes:
        stamps_s: (T,) increasing times over the sequence.
        position_m: (T, 3) positions.
        speed_mps, rate_degps: (T,) maxima up to the next stamp.
        length_m: length of the path.
        climb_m: height of its highest above its lowest point.
        segments_m: (n, 3) path of each segment of the scenario.
    """

    stamps_s: np.ndarray
    position_m: np.ndarray
    speed_mps: np.ndarray
    rate_degps: np.ndarray
    length_m: float
    climb_m: float
    segments_m: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Sheet:
    """One scenario with one seed.

    Attributes:
        scenario: the sampled scenario.
        frames: number of frames of the sequence.
        thumbs: thumbnails in time order.
        track: motion of the camera.
        map_frame: area of the map.
        outline_file: picture of the outline of the world, relative to the gallery.
    """

    scenario: Scenario
    frames: int
    thumbs: tuple[Thumb, ...]
    track: Track
    map_frame: MapFrame
    outline_file: str


def make_sheet(scenario: Scenario, frames: int, folder: Path, backend: RenderBackend | None = None) -> Sheet:
    """Plan a sequence, render some frames, write thumbnails and the outline of the world.

    Args:
        scenario: the scenario with its seed.
        frames: number of frames, at least one per segment.
        folder: folder of the gallery; pictures go into a folder inside it.
        backend: render backend; None for MuJoCo.

    Raises:
        InputError: no GL, or impossible sizes of the world.
    """
    look = preview(scenario, backend)
    pictures = f"pictures/{scenario.name.replace('/', '.')}/seed-{scenario.seed}"
    (folder / pictures).mkdir(parents=True)
    thumbs = _thumbs(look, frames, folder, pictures)
    track = _track(look.plan.motion, scenario)
    map_frame = frame_of(track.position_m[:, :2])
    outline_file = f"{pictures}/outline.png"
    _write(folder / outline_file, draw_outline(look.world, track.position_m[:, 2], map_frame))
    return Sheet(scenario, len(look.plan.stamps_s), thumbs, track, map_frame, outline_file)


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
    images, blur_px = look.expose_frames(chosen)
    thumbs = []
    for place, (frame, image) in enumerate(zip(chosen, images, strict=True)):
        small = _thumbnail(image)
        file = f"{pictures}/frame-{place + 1:02}.jpg"
        _write(folder / file, small)
        T_world_cam = plan.motion.T_world_cam(float(plan.stamps_s[frame]))
        thumbs.append(
            Thumb(
                file=file,
                width_px=small.shape[1],
                height_px=small.shape[0],
                frame=frame,
                stamp_s=float(plan.stamps_s[frame]),
                segment=next((k for k, s in enumerate(segments) if plan.within(s)[frame]), None),
                blur_px=float(blur_px[place]),
                position_m=T_world_cam[:3, 3],
                gaze=T_world_cam[:2, 2],
            )
        )
    return tuple(thumbs)


def _thumbnail(image: np.ndarray) -> np.ndarray:
    scale = min(1.0, np.sqrt(THUMB_PIXELS / image.size))
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _track(motion: Motion, scenario: Scenario) -> Track:
    count = max(2, round(scenario.duration_s / _MEASURE_STEP_S))
    steps = -(-count // _TRACK_POINTS)
    stamps_s = np.linspace(0, scenario.duration_s, steps * -(-count // steps))
    position_m = motion.T_world_cam(stamps_s)[:, :3, 3]
    speed_mps = np.linalg.norm(motion.velocity_mps(stamps_s), axis=1)
    rate_degps = np.rad2deg(np.linalg.norm(motion.rate_radps(stamps_s), axis=1))
    spans = [np.linspace(s.start_s, s.end_s, _SEGMENT_POINTS) for s in scenario.segments]
    return Track(
        stamps_s=stamps_s[::steps],
        position_m=position_m[::steps],
        speed_mps=speed_mps.reshape(-1, steps).max(axis=1),
        rate_degps=rate_degps.reshape(-1, steps).max(axis=1),
        length_m=float(np.linalg.norm(np.diff(position_m, axis=0), axis=1).sum()),
        climb_m=float(np.ptp(position_m[:, 2])),
        segments_m=tuple(motion.T_world_cam(span_s)[:, :3, 3] for span_s in spans),
    )


def _write(path: Path, image: np.ndarray) -> None:
    """Write an image; Python raises on a write error where OpenCV only returns False."""
    options = (
        [cv2.IMWRITE_JPEG_QUALITY, _QUALITY] if path.suffix == ".jpg" else [cv2.IMWRITE_PNG_COMPRESSION, 9]
    )
    path.write_bytes(cv2.imencode(path.suffix, image, options)[1].tobytes())
