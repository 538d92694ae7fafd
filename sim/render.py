"""From a scenario and a seed to a sequence: frames and truth."""

import hashlib
import json
import platform
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import scenarios
import sim
from scenarios.spec import Camera, CorridorWorld, RoomWorld, Scenario
from sim.cache import FolderCache, content_key
from sim.camera import Intrinsics
from sim.degradations.base import Shoot, Stage, segment_truth
from sim.degradations.exposure import expose
from sim.degradations.noise import SensorNoise
from sim.degradations.registry import DEGRADATIONS
from sim.io.raw import RawFrames, RawWriter
from sim.io.tum import claim_output_dir, write_tum
from sim.motion.walker import plan_walk
from sim.renderer import Renderer
from sim.sequence import SegmentTruth, Sequence
from sim.world.base import Route, WorldModel

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, frames done and frames in all."""

_SURVEY_WIDTH_PX = 80
_PACKAGES = ("dual-slam-lab", "mujoco", "numba", "numpy", "opencv-contrib-python-headless", "scipy")


@dataclass(frozen=True)
class Studio:
    """What renders: the worlds and the renderer behind their interfaces.

    Attributes:
        layout: route through a world, from its spec and a seed.
        build_world: the world itself.
        renderer: renderer of a world through a camera.
        gl_info: names of the GL implementation.
    """

    layout: Callable[[RoomWorld | CorridorWorld, int], Route]
    build_world: Callable[[RoomWorld | CorridorWorld, int], WorldModel]
    renderer: Callable[[WorldModel, Intrinsics], Renderer]
    gl_info: Callable[[], dict[str, str]]


def mujoco_studio() -> Studio:
    """The worlds of ``sim.world``, rendered by MuJoCo."""
    from sim.gl_context import gl_info
    from sim.mujoco_renderer import MujocoRenderer
    from sim.world import build_world, layout

    return Studio(layout, build_world, MujocoRenderer, gl_info)


def render_sequence(
    scenario: Scenario,
    seed: int | None = None,
    *,
    out_dir: Path | None = None,
    cache_dir: Path | None = None,
    depth: bool = False,
    progress: Progress | None = None,
    studio: Studio | None = None,
) -> Sequence:
    """Render a scenario, or take it from the cache.

    The same scenario and seed give the same bytes on one machine and GL driver. Frames stay on disk and are
    read one by one.

    Args:
        scenario: what happens.
        seed: root seed; None for the scenario's own.
        out_dir: also write the sequence there as a TUM-form folder.
        cache_dir: folder of the cache; None for the default one.
        depth: keep depth images too.
        progress: told of every frame.
        studio: what renders; None for MuJoCo.

    Raises:
        InputError: no GL, the world's sizes do not fit, a folder cannot be written, the disk is full.
    """
    seed = scenario.seed if seed is None else seed
    studio = studio or mujoco_studio()
    progress = progress or (lambda step, done, total: None)
    if out_dir is not None:
        claim_output_dir(out_dir)
    meta = _provenance(scenario, seed, studio)
    store = FolderCache(cache_dir)
    key = content_key({"depth": depth, "sources": _source_hash(), **meta})
    entry = store.find(key)
    if entry is None:
        with store.create(key) as folder:
            _render_into(folder, scenario, seed, depth, studio, progress)
        entry = store.root / key
    sequence = _open(entry, scenario, meta)
    if out_dir is not None:
        write_tum(sequence, out_dir, depth=depth, progress=progress)
    return sequence


def plan_shoot(scenario: Scenario, seed: int, studio: Studio, progress: Progress) -> tuple[Shoot, WorldModel]:
    """Everything that decides the frames, with every segment applied, and the world with its contrasts."""
    camera = scenario.camera
    stamps_s = np.arange(scenario.frame_count) / camera.fps
    world = studio.build_world(scenario.world, seed)
    motion = plan_walk(studio.layout(scenario.world, seed), scenario.trajectory, scenario.duration_s, seed)
    shoot = Shoot(
        stamps_s=stamps_s,
        motion=motion,
        exposure_s=np.full(len(stamps_s), camera.exposure_s),
        contrast=np.ones(len(world.surfaces)),
        view_share=np.zeros((len(stamps_s), 0), np.float32),
    )
    for stage in Stage:
        segments = [s for s in scenario.segments if DEGRADATIONS[s.kind].stage is stage]
        if stage is Stage.WORLD and segments:
            shoot = replace(shoot, view_share=_survey(shoot, world, camera, studio, progress))
        for segment in segments:
            shoot = DEGRADATIONS[segment.kind].apply(shoot, segment)
    return shoot, replace(world, contrast=shoot.contrast)


def camera_intrinsics(camera: Camera) -> Intrinsics:
    """The intrinsics of a scenario's camera."""
    return Intrinsics(
        camera.width_px,
        camera.height_px,
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        camera.fps,
    )


def _survey(
    shoot: Shoot, world: WorldModel, camera: Camera, studio: Studio, progress: Progress
) -> np.ndarray:
    """(N, S) float32 share of the view that each surface fills in each frame, seen in small."""
    scale = _SURVEY_WIDTH_PX / camera.width_px
    small = Intrinsics(
        width_px=_SURVEY_WIDTH_PX,
        height_px=max(1, round(camera.height_px * scale)),
        fx=camera.fx_px * scale,
        fy=camera.fy_px * scale,
        cx=(camera.cx_px + 0.5) * scale - 0.5,
        cy=(camera.cy_px + 0.5) * scale - 0.5,
        fps=camera.fps,
    )
    poses = shoot.motion.T_world_cam(shoot.stamps_s)
    shares = np.zeros((len(poses), len(world.surfaces)), np.float32)
    renderer = studio.renderer(world, small)
    try:
        for frame, T_world_cam in enumerate(poses):
            ids = renderer.render_surface_ids(T_world_cam)
            # Index -1, no surface, is counted in front and dropped.
            counts = np.bincount(ids.ravel() + 1, minlength=len(world.surfaces) + 1)[1:]
            shares[frame] = counts / ids.size
            progress("surveying", frame + 1, len(poses))
    finally:
        renderer.close()
    return shares


def _render_into(
    folder: Path, scenario: Scenario, seed: int, depth: bool, studio: Studio, progress: Progress
) -> None:
    """Write the frames and the truth of a sequence into a folder of the cache."""
    shoot, world = plan_shoot(scenario, seed, studio, progress)
    renderer = studio.renderer(world, camera_intrinsics(scenario.camera))
    try:
        blur_px = _film(folder, shoot, renderer, scenario.camera, seed, depth, progress)
    finally:
        renderer.close()
    columns = {"exposure_s": shoot.exposure_s, "blur_px": blur_px}
    truths = []
    for segment in scenario.segments:
        truth, measure = segment_truth(DEGRADATIONS[segment.kind], shoot, segment, blur_px)
        truths.append(asdict(truth))
        columns[truth.measure] = np.maximum(columns.get(truth.measure, 0.0), measure)
    (folder / "segments.json").write_text(json.dumps(truths))
    np.save(folder / "stamps_s.npy", shoot.stamps_s)
    np.save(folder / "T_world_cam.npy", shoot.motion.T_world_cam(shoot.stamps_s))
    np.savez(folder / "frame_truth.npz", **columns)


def _film(
    folder: Path, shoot: Shoot, renderer: Renderer, camera: Camera, seed: int, depth: bool, progress: Progress
) -> np.ndarray:
    """Render, expose and add noise, frame by frame; returns (N,) median blur lengths, pixels."""
    intrinsics = camera_intrinsics(camera)
    count, size = len(shoot.stamps_s), (camera.height_px, camera.width_px)
    noise = SensorNoise(size, camera.noise_sigma, seed)
    half_s = shoot.exposure_s / 2
    T_world_mid = shoot.motion.T_world_cam(shoot.stamps_s)
    T_mid_world = np.linalg.inv(T_world_mid)
    T_mid_open = T_mid_world @ shoot.motion.T_world_cam(shoot.stamps_s - half_s)
    T_mid_close = T_mid_world @ shoot.motion.T_world_cam(shoot.stamps_s + half_s)
    blur_px = np.zeros(count)
    with ExitStack() as files:
        grays = files.enter_context(RawWriter(folder / "gray.npy", (count, *size), np.uint8))
        depths = (
            files.enter_context(RawWriter(folder / "depth.npy", (count, *size), np.float32))
            if depth
            else None
        )
        for frame in range(count):
            sharp, depth_m = renderer.render(T_world_mid[frame])
            image, blur_px[frame] = expose(sharp, depth_m, intrinsics, T_mid_open[frame], T_mid_close[frame])
            grays.append(noise.apply(image, frame))
            if depths:
                depths.append(depth_m)
            progress("rendering", frame + 1, count)
    return blur_px


def _open(entry: Path, scenario: Scenario, meta: dict[str, Any]) -> Sequence:
    """The sequence of a complete cache entry."""
    segments = json.loads((entry / "segments.json").read_text())
    with np.load(entry / "frame_truth.npz") as truth:
        columns = {name: truth[name] for name in sorted(truth.files)}
    depth_file = entry / "depth.npy"
    return Sequence(
        name=scenario.name,
        camera=camera_intrinsics(scenario.camera),
        stamps_s=np.load(entry / "stamps_s.npy"),
        frames=RawFrames(entry / "gray.npy"),
        T_world_cam=np.load(entry / "T_world_cam.npy"),
        depths=RawFrames(depth_file) if depth_file.exists() else None,
        segments=tuple(SegmentTruth(**segment) for segment in segments),
        meta=meta,
        frame_truth=columns,
    )


def _provenance(scenario: Scenario, seed: int, studio: Studio) -> dict[str, Any]:
    """What the frames depend on, as JSON-like data."""
    return {
        "spec": scenario.model_copy(update={"seed": seed}).model_dump(mode="json"),
        "seed": seed,
        "versions": {"python": platform.python_version(), **_versions()},
        "gl": studio.gl_info(),
        "stamps": "centre of the exposure",
        "poses": "camera (x right, y down, z forward) to world (z up), metres, at the stamp",
    }


@cache
def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


@cache
def _source_hash() -> str:
    """Hash of every source file that can change a pixel: a changed renderer finds no old frames."""
    digest = hashlib.sha256()
    for package in (scenarios, sim):
        root = Path(str(package.__file__)).parent
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
