"""Small rendered worlds, and the number of feature matches between their frames."""

import hashlib
from dataclasses import replace
from functools import cache

import cv2
import numpy as np

from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.sim.frame_plan import RenderBackend, render_backend
from dslab.sim.link import NO_IMAGE, Link, Shutter, View, fold
from dslab.sim.sequence import Sequence

START_S, DURATION_S = 0.2, 0.4
WORLDS = {
    "room": {"kind": "room", "length_m": 6, "width_m": 5},
    "corridor": {"kind": "corridor", "length_m": 12, "turns": 0},
    "warehouse": {"kind": "warehouse", "length_m": 12, "aisles": 2, "height_m": 4},
}
SEVERITIES = {
    "low_texture": [{"contrast": c} for c in (1, 0.2, 0.08, 0.03, 0)],
    # The patch is so small that features find their double within the search radius.
    "repeated_texture": [{"share": s, "period_m": 0.1} for s in (0, 0.25, 0.5, 0.75, 1)],
    "motion_blur": [{"exposure_s": e} for e in (0.004, 0.03, 0.08, 0.2, 0.5)],
    "fast_rotation": [{"rate_degps": r} for r in (0, 80, 160, 300, 600)],
    "pure_rotation": [{"angle_deg": a} for a in (0, 20, 45, 90, 180)],
    "frame_drops": [{"share": s} for s in (0, 0.25, 0.5, 0.75, 1)],
    "time_jitter": [{"sigma_s": s} for s in (0, 0.004, 0.01, 0.02, 0.05)],
    "fog": [{"extinction_per_m": e} for e in (0, 0.3, 0.8, 1.5, 4)],
    "moving_objects": [{"share": s} for s in (0, 0.2, 0.4, 0.6, 0.9)],
    "rolling_shutter": [{"readout_s": r} for r in (0, 0.05, 0.1, 0.2, 0.4)],
    "defocus": [{"diameter_px": d} for d in (0, 3, 6, 12, 24)],
    "rain": [{"rate_mmph": r} for r in (0, 5, 20, 80, 300)],
    "lens_dirt": [{"share": s} for s in (0, 0.2, 0.4, 0.6, 0.9)],
    "shallow_focus": [{"aperture_mm": a, "focus_m": 0.3} for a in (0, 10, 20, 40, 80)],
    "lens_flare": [{"veil": v} for v in (0, 0.1, 0.3, 0.8, 5)],
    "cracked_lens": [{"cracks": c, "bend_deg": 2} for c in (0, 5, 20, 60, 200)],
    "vignetting": [{"stops": s} for s in (0, 3, 6, 10, 16)],
    "flicker": [{"modulation": m, "readout_s": 0.1} for m in (0, 0.4, 0.6, 0.8, 1)],
    "day_to_night": [{"stops": s} for s in (0, 6, 9, 12, 15)],
    "covered_lens": [{"transmission": t} for t in (1, 0.1, 0.02, 0.005, 0)],
    "low_light": [{"illumination": i} for i in (1, 0.1, 0.02, 0.005, 0.0005)],
    "over_exposure": [{"stops": s} for s in (0, 1.5, 3, 4.5, 7)],
    "auto_exposure_lag": [{"stops": s, "time_constant_s": 1.0} for s in (0, 2, 4, 6, 9)],
    "jpeg": [{"quality": q} for q in (100, 20, 10, 5, 1)],
    "bandwidth_loss": [{"share": s} for s in (0, 0.2, 0.4, 0.6, 0.9)],
}
"""Severities of every kind, from no effect to the end of matching."""


def small_scenario(world: str, *segments: dict, **more) -> Scenario:
    """A scenario of 0.8 seconds at 20 frames per second, 240x180 pixels."""
    camera = {"width_px": 240, "height_px": 180, "fx_px": 180, "fy_px": 180, "cx_px": 119.5, "cy_px": 89.5}
    return Scenario.model_validate(
        {
            "name": "small",
            "duration_s": 0.8,
            "world": WORLDS[world],
            "trajectory": {"gaze_deg": 60, "max_speed_mps": 1.5, "max_rate_degps": 60},
            "camera": {**camera, "fps": 20, "noise_sigma": 1},
            "segments": segments,
            **more,
        }
    )


def segment(kind: str, **severity) -> dict:
    """A segment in the middle of a ``small_scenario``, or over all of it if the kind acts on the world."""
    if DEGRADATIONS[kind].stage is Stage.WORLD:
        return {"kind": kind, "start_s": 0, "duration_s": 0.8, **severity}
    return {"kind": kind, "start_s": START_S, "duration_s": DURATION_S, **severity}


@cache
def small_backend() -> RenderBackend:
    """The real worlds with coarse textures and the real renderer; both are built once per process."""
    real = render_backend()
    worlds, renderers = {}, {}

    def build_world(spec, seed):
        key = (spec, seed)
        if key not in worlds:
            world = real.build_world(spec, seed)
            half = [
                cv2.resize(s.texture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                for s in world.surfaces
            ]
            surfaces = [replace(s, texture=t) for s, t in zip(world.surfaces, half, strict=True)]
            worlds[key] = replace(world, surfaces=surfaces)
        return worlds[key]

    class Kept:
        def __init__(self, world, camera) -> None:
            key = (tuple(id(s) for s in world.surfaces), world.contrast.tobytes(), camera)
            if key not in renderers:
                # The world is kept too, so that the ids of its surfaces are not given again.
                renderers[key] = (real.renderer(world, camera), world)
            self.render = renderers[key][0].render
            self.render_surface_ids = renderers[key][0].render_surface_ids

        def close(self) -> None:
            pass

    return RenderBackend(real.layout, build_world, Kept, real.gl_info)


def sharp_frame(links: list[Link], T_world_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image and depth that the links of ``sim.imaging.rendered`` give at a pose."""
    still = Shutter(T_world_cam, np.eye(4), np.eye(4))
    image, view = fold(links, NO_IMAGE, View(0, 0.0, shutter=still))
    assert view.depth_m is not None
    return image, view.depth_m


def digest(sequence: Sequence) -> str:
    """Digest of frames, stamps and poses."""
    assert sequence.T_world_cam is not None
    frames = b"".join(frame.tobytes() for frame in sequence.frames)
    return hashlib.sha256(frames + sequence.stamps_s.tobytes() + sequence.T_world_cam.tobytes()).hexdigest()


def mean_inliers(
    sequence: Sequence, known: Sequence | None = None, prediction_px: float = 4.0, error_px: float = 2.0
) -> float:
    """Mean number of correct ORB matches from frame to frame in the segment's time.

    The earlier frame of each pair is taken from ``known``, with the same stamps, if it is given. A match
    counts if it ends at the true position of the point, within the search radius about the position that
    constant velocity predicts from the stamps.
    """
    assert sequence.T_world_cam is not None and sequence.depths is not None
    orb = cv2.ORB_create(400, fastThreshold=12)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    T, stamps_s, counts = sequence.T_world_cam, sequence.stamps_s, []
    true_s = np.where((stamps_s >= START_S) & (stamps_s < START_S + DURATION_S))[0]
    for after in true_s[true_s >= 2]:
        before, count = after - 1, 0
        points, described = orb.detectAndCompute((known or sequence).frames[before], None)
        there, described_there = orb.detectAndCompute(sequence.frames[after], None)
        if described is not None and described_there is not None:
            matches = matcher.match(described, described_there)
            at = np.array([points[m.queryIdx].pt for m in matches]).reshape(-1, 2)
            to = np.array([there[m.trainIdx].pt for m in matches]).reshape(-1, 2)
            depth_m = sequence.depths[before][tuple(np.rint(at[:, ::-1]).astype(int).T)]
            true_to = _projected(sequence, at, depth_m, np.linalg.inv(T[after]) @ T[before])
            share = (stamps_s[after] - stamps_s[before]) / (stamps_s[before] - stamps_s[before - 1])
            guess = _projected(sequence, at, depth_m, _part(np.linalg.inv(T[before]) @ T[before - 1], share))
            right = np.linalg.norm(to - true_to, axis=1) < error_px
            count = int((right & (np.linalg.norm(to - guess, axis=1) < prediction_px)).sum())
        counts.append(count)
    return float(np.mean(counts))


def _projected(sequence: Sequence, at: np.ndarray, depth_m: np.ndarray, T: np.ndarray) -> np.ndarray:
    camera = sequence.camera
    rays = np.column_stack([(at - (camera.cx, camera.cy)) / (camera.fx, camera.fy), np.ones(len(at))])
    points = rays * depth_m[:, None] @ T[:3, :3].T + T[:3, 3]
    return points[:, :2] / np.maximum(points[:, 2:], 1e-3) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def _part(T: np.ndarray, share: float) -> np.ndarray:
    """A share of a small motion."""
    part = np.eye(4)
    part[:3, :3] = cv2.Rodrigues(share * cv2.Rodrigues(T[:3, :3])[0])[0]
    part[:3, 3] = share * T[:3, 3]
    return part
