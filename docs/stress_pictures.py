"""Pictures of the kinds of stress for the documentation: one moment without and with each."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan, Stage
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.sim.preview import Preview, preview

STREET = {
    "name": "street",
    "seed": 1,
    "world": {"kind": "city", "length_m": 240, "sky": "clear"},
    "trajectory": {"kind": "handheld", "gaze_deg": 15},
    "camera": {
        "width_px": 480,
        "height_px": 300,
        "fx_px": 330,
        "fy_px": 330,
        "cx_px": 239.5,
        "cy_px": 149.5,
        "fps": 20,
    },
}
EVERY_S, LASTS_S = 2.5, 2.0
SHOWN = {
    "pure_rotation": {"angle_deg": 30},
    "fast_rotation": {"rate_degps": 90},
    "low_texture": {"contrast": 0.05},
    "repeated_texture": {"share": 1.0, "period_m": 1.0},
    "motion_blur": {"exposure_s": 0.3},
    "frame_drops": {"share": 0.5},
    "time_jitter": {"sigma_s": 0.02},
    "fog": {"extinction_per_m": 0.06},
    "moving_objects": {"share": 0.35},
    "rolling_shutter": {"readout_s": 0.8},
    "rain": {"rate_mmph": 80},
    "defocus": {"diameter_px": 9},
    "lens_dirt": {"share": 0.35},
    "shallow_focus": {"aperture_mm": 150, "focus_m": 4},
    "lens_flare": {"veil": 0.2, "off_axis_deg": 12},
    "cracked_lens": {"cracks": 12, "bend_deg": 0.8},
    "vignetting": {"stops": 4},
    "covered_lens": {"transmission": 0.05},
    "flicker": {"modulation": 0.6},
    "day_to_night": {"stops": 8, "lamp": 0.02},
    "low_light": {"illumination": 0.05, "gain": 10},
    "over_exposure": {"stops": 2},
    "auto_exposure_lag": {"stops": 3, "time_constant_s": 2},
    "jpeg": {"quality": 3},
    "bandwidth_loss": {"share": 0.25},
}
"""Severities that can be seen; those of other kinds are drawn."""


def draw_pictures(folder: Path) -> None:
    """Write a picture of every kind into a folder, which is made."""
    folder.mkdir()
    # A walk has one segment after the other; what changes the world would be seen in others.
    kinds = sorted(DEGRADATIONS, key=lambda kind: DEGRADATIONS[kind].stage, reverse=True)
    of_the_world = [kind for kind in kinds if DEGRADATIONS[kind].stage is Stage.WORLD]
    for walk in ([kind for kind in kinds if kind not in of_the_world], *([kind] for kind in of_the_world)):
        _draw_walk(walk, folder)


def _draw_walk(kinds: list[str], folder: Path) -> None:
    segments = [_segment(kind, EVERY_S * number) for number, kind in enumerate(kinds)]
    walk = STREET | {"duration_s": EVERY_S * len(kinds)}
    clean, stressed = (preview(Scenario.model_validate(walk | {"segments": s})) for s in ([], segments))
    middles = [segment["start_s"] + LASTS_S / 2 for segment in segments]
    pairs = zip(*(_frames(look, middles) for look in (clean, stressed)), strict=True)
    for kind, segment, (before, after) in zip(kinds, segments, pairs, strict=True):
        if DEGRADATIONS[kind].stage is Stage.TIMING:
            (folder / f"{kind}.svg").write_text(_stamps(clean.plan, stressed.plan, segment["start_s"] - 0.25))
            continue
        gap = np.full((len(before), 8), 255, np.uint8)
        picture = cv2.imencode(".jpg", np.hstack([before, gap, after]), [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
        (folder / f"{kind}.jpg").write_bytes(picture.tobytes())


def _segment(kind: str, start_s: float) -> dict[str, Any]:
    severity = SHOWN.get(kind) or DEGRADATIONS[kind].sample(rng_for(1, "documentation", kind))
    return {"kind": kind, "start_s": start_s + 0.25, "duration_s": LASTS_S, **severity}


def _frames(look: Preview, stamps_s: list[float]) -> list[np.ndarray]:
    """The frames nearest to some times."""
    return look.expose_frames([int(np.abs(look.plan.stamps_s - stamp_s).argmin()) for stamp_s in stamps_s])[0]


def _stamps(clean: FramePlan, stressed: FramePlan, start_s: float) -> str:
    """A drawing of the frames' written stamps, without and with a segment."""
    rows = []
    for y, plan in ((10, clean), (50, stressed)):
        x = 968 * (plan.stamps_s + plan.stamp_error_s - start_s) / EVERY_S
        rows += [
            f'<path d="M{at:.1f} {y}v20" stroke="#5c6bc0" stroke-width="4"/>' for at in x[(x > 0) & (x < 968)]
        ]
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 968 80">{"".join(rows)}</svg>\n'
