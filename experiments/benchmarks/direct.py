"""Photometric alignment against exact depth and pose: errors, basin, CPU time, memory of the images held.

Rendered pairs of frames, one to ten apart. The reference's pixels have their exact depth, so that what is
measured is the alignment alone. The guesses are those of the direct thread: the motion before the first frame
goes on, slower and faster, none, and as the whole image has turned.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.experiments.runs.execution import slam_camera
from dslab.scenarios.families import load_family
from dslab.scenarios.spec import Scenario
from dslab.sim.sequence import Sequence as ImageSequence
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.core.seeds import rng_for
from dslab.slam.direct.alignment import Aligned, Reference, align
from dslab.slam.direct.location import locate_on_lines, locate_points
from dslab.slam.direct.placement import guesses_ahead
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.direct.selection import SelectionConfig, select
from dslab.slam.dual.buffer import JPEG_QUALITY

WORLDS = ("corridor", "room", "warehouse", "city", "field")
GAPS = tuple(range(1, 11))
BASIN_PX = (2.0, 4.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
"""Turns by which a single guess is off, in pixels of the image centre."""
ASKED = {"translation_share": 0.002, "rotation_deg": 0.05, "frame_cpu_ms": 10.0, "keyframe_cpu_ms": 40.0}
"""Most of the medians."""
_CAMERA = {
    "width_px": 640, "height_px": 480, "fx_px": 500.0, "fy_px": 500.0, "cx_px": 319.5, "cy_px": 239.5,
    "fps": 30.0,
}  # fmt: skip
_DURATION_S = 3.0
_STARTS = (0.2, 0.45, 0.7)  # of the sequence: frames that pairs begin with
_BASIN_GAP = 3
_DIRECTIONS = 6
_NEAR = 3.0  # times what is asked: an alignment that has found the motion
_HELD_S = 10.0
_POINTS = 1500
_LINE_PX, _LINE_ERROR, _DISTINCT = 60.0, 12.0, 1.6


def bench_direct(
    seeds: Sequence[int], progress: Callable[[str, int, int], None] | None = None
) -> dict[str, Any]:
    """Measure photometric alignment in five worlds.

    Args:
        seeds: of the worlds.
        progress: called with (step, done, total).

    Returns:
        JSON-like: under ``worlds`` a row per world, under ``all`` that of all pairs: ``pairs``, ``missed``
        (errors of more than three times what is asked, or no alignment), medians of the errors, ``basin_px``
        and ``basin_deg``; under ``cpu_ms`` medians per step; ``held_mb`` per world; ``asked``.
    """
    show = progress or (lambda step, done, total: None)
    pairs: list[_Pair] = []
    basin: list[tuple[str, float, bool]] = []
    times: dict[str, list[float]] = {}
    sizes: dict[str, list[float]] = {}
    total = len(WORLDS) * len(seeds)
    for done, (world, seed) in enumerate((w, s) for w in WORLDS for s in seeds):
        show("measuring alignment", done, total)
        with scratch_folder() as cache:
            sequence = render_sequence(_scenario(world, seed), cache_dir=cache, depth=True)
            for start in _STARTS:
                views = _Views(world, sequence, int(start * len(sequence)), times)
                pairs += views.pairs()
                basin += views.basin(seed)
            sizes.setdefault(world, []).append(_held_mb(sequence))
    show("measuring alignment", total, total)
    return {
        "seeds": list(seeds),
        "worlds": {world: _row(world, pairs, basin) for world in WORLDS},
        "all": _row(None, pairs, basin),
        "cpu_ms": {step: float(np.median(values)) for step, values in times.items()},
        "held_mb": {world: float(np.mean(values)) for world, values in sizes.items()},
        "asked": ASKED,
    }


@dataclass(frozen=True)
class _Pair:
    world: str
    gap: int
    translation_share: float  # of the median depth; NaN without an alignment
    rotation_deg: float


class _Views:
    """Alignments of the frames after one with it; the CPU time of each step is added to ``times``."""

    def __init__(
        self, world: str, sequence: ImageSequence, start: int, times: dict[str, list[float]]
    ) -> None:
        if sequence.depths is None or sequence.T_world_cam is None:
            raise ValueError("alignment is measured against exact depth and pose, which this sequence lacks")
        self._world, self._frames, self._start, self._times = world, sequence.frames, start, times
        self._T_world_cam = sequence.T_world_cam
        self._rectifier = Rectifier(slam_camera(sequence.camera))
        source = self._timed("pyramid", self._pyramid, start)
        selected = self._timed("selection", select, source, SelectionConfig(points=_POINTS))
        column, row = selected.xy.T
        depth = sequence.depths[start][row, column]
        known = depth > 0
        self._source, self._xy = source, selected.xy[known].astype(float)
        self._depth = float(np.median(depth[known]))
        inverse = 1 / depth[known].astype(float)
        self._view = self._timed(
            "reference", Reference, source, self._rectifier.intrinsics, self._xy, inverse
        )

    def pairs(self) -> list[_Pair]:
        """Errors at every gap."""
        velocity = np.linalg.inv(self._T_world_cam[self._start]) @ self._T_world_cam[self._start - 1]
        found = []
        for gap in GAPS:
            guesses = guesses_ahead(velocity, gap)
            target = self._pyramid(self._start + gap)
            aligned = self._timed("alignment", align, self._view, target, guesses)
            if aligned is not None:
                self._timed("location", locate_points, self._view, target, aligned)
                self._timed(
                    "epipolar lines", locate_on_lines, self._source, target, self._rectifier.intrinsics[0],
                    self._xy, aligned, self._depth, _LINE_PX, _LINE_ERROR, _DISTINCT,
                )  # fmt: skip
            found.append(_Pair(self._world, gap, *self._errors(aligned, gap)))
        return found

    def basin(self, seed: int) -> list[tuple[str, float, bool]]:
        """For turns about axes in the image plane by which a single guess is off: is the motion found?"""
        target, truth = self._pyramid(self._start + _BASIN_GAP), self._truth(_BASIN_GAP)
        rng = rng_for(seed, "basin", self._start)
        tried = []
        for off_px in BASIN_PX:
            for angle in rng.uniform(0, 2 * np.pi, _DIRECTIONS):
                turn = np.eye(4)
                axis = np.array([np.cos(angle), np.sin(angle), 0.0])
                off = np.arctan(off_px / _CAMERA["fx_px"])
                turn[:3, :3] = Rotation.from_rotvec(off * axis).as_matrix()
                aligned = align(self._view, target, [turn @ truth])
                tried.append((self._world, off_px, _is_near(*self._errors(aligned, _BASIN_GAP))))
        return tried

    def _pyramid(self, index: int) -> ImagePyramid:
        return self._rectifier.pyramid(self._frames[index])

    def _truth(self, gap: int) -> np.ndarray:
        return np.linalg.inv(self._T_world_cam[self._start + gap]) @ self._T_world_cam[self._start]

    def _errors(self, aligned: Aligned | None, gap: int) -> tuple[float, float]:
        if aligned is None:
            return np.nan, np.nan
        off = np.linalg.inv(self._truth(gap)) @ aligned.T_target_ref
        turned = Rotation.from_matrix(off[:3, :3]).magnitude()
        return float(np.linalg.norm(off[:3, 3]) / self._depth), float(np.rad2deg(turned))

    def _timed(self, step: str, work: Callable[..., Any], *arguments: Any) -> Any:
        started = time.thread_time()
        made = work(*arguments)
        self._times.setdefault(step, []).append(1e3 * (time.thread_time() - started))
        return made


def _is_near(translation_share: float, rotation_deg: float) -> bool:
    """True if the motion is found; False without an alignment."""
    near = translation_share < _NEAR * ASKED["translation_share"]
    return near and rotation_deg < _NEAR * ASKED["rotation_deg"]


def _scenario(world: str, seed: int) -> Scenario:
    small = load_family("small").member(world).sample(seed)
    return Scenario.model_validate(small.model_dump() | {"duration_s": _DURATION_S, "camera": _CAMERA})


def _held_mb(sequence: ImageSequence) -> float:
    """Megabytes of the images of ten seconds as the buffer holds them."""
    import cv2

    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    sizes = [cv2.imencode(".jpg", sequence.frames[i], quality)[1].size for i in range(0, len(sequence), 10)]
    return 1e-6 * float(np.mean(sizes)) * _HELD_S * sequence.camera.fps


def _row(
    world: str | None, pairs: list[_Pair], basin: list[tuple[str, float, bool]]
) -> dict[str, float | int | None]:
    own = [pair for pair in pairs if world in (None, pair.world)]
    known = [pair for pair in own if np.isfinite(pair.rotation_deg)]
    off_px = _basin_px([(px, found) for of, px, found in basin if world in (None, of)])
    missed = sum(not _is_near(pair.translation_share, pair.rotation_deg) for pair in own)
    row: dict[str, float | int | None] = {"pairs": len(own), "missed": missed}
    for name in ("translation_share", "rotation_deg"):
        values = [getattr(pair, name) for pair in known]
        row[f"{name}_median"] = float(np.median(values)) if values else None
    row["basin_px"] = off_px
    row["basin_deg"] = float(np.rad2deg(np.arctan(off_px / _CAMERA["fx_px"])))
    return row


def _basin_px(tried: list[tuple[float, bool]]) -> float:
    """Largest offset up to which nine of ten guesses find the motion, at it and at every smaller one."""
    reached = 0.0
    for off_px in BASIN_PX:
        found = [f for px, f in tried if px == off_px]
        if not found or np.mean(found) < 0.9:
            break
        reached = off_px
    return reached
