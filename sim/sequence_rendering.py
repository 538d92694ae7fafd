"""From a scenario and a seed to a sequence: frames and truth."""

import hashlib
import json
import platform
from contextlib import nullcontext
from dataclasses import asdict
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import scenarios
from scenarios.extensions import extension_digests
from scenarios.segments import ImageSegment
from scenarios.spec import Scenario
from sim.cache import FolderCache, content_key
from sim.degradations.base import FramePlan, Stage
from sim.degradations.chain import ImageChain
from sim.degradations.registry import DEGRADATIONS, in_order_of_action
from sim.degradations.truths import truths_of
from sim.frame_plan import (
    Progress,
    RenderBackend,
    camera_intrinsics,
    expose_frames,
    ideal_camera,
    mujoco_backend,
    plan_frames,
    plan_in_world,
    render_backend,
    rendered_clean_frames,
    store_clean_frames,
    stored_clean_frames,
)
from sim.io.folders import check_free
from sim.io.raw import RawFrames
from sim.io.tum import write_tum
from sim.sequence import SegmentTruth, Sequence

__all__ = [
    "Progress",
    "RenderBackend",
    "camera_intrinsics",
    "mujoco_backend",
    "plan_frames",
    "render_backend",
    "render_sequence",
]

_PACKAGES = (
    "dual-slam-lab",
    "mujoco",
    "numba",
    "numpy",
    "opencv-contrib-python-headless",
    "pyopengl",
    "pyrender",
    "scipy",
)


def render_sequence(
    scenario: Scenario,
    seed: int | None = None,
    *,
    out_dir: Path | None = None,
    cache_dir: Path | None = None,
    depth: bool = False,
    progress: Progress | None = None,
    backend: RenderBackend | None = None,
) -> Sequence:
    """Render a scenario, or read it from the cache.

    The same scenario and seed give the same bytes on one machine and GL driver. Frames stay on disk and are
    read one by one. With segments that act on images, the clean frames with their depth are cached too:
    another severity renders nothing again.

    Args:
        scenario: what happens.
        seed: root seed; None for the scenario's own.
        out_dir: also write the sequence there as a TUM-form folder.
        cache_dir: folder of the cache; None for the default one.
        depth: keep depth images too.
        progress: called after every frame.
        backend: worlds and renderer; None for MuJoCo.

    Raises:
        InputError: no GL, the world's sizes do not fit, a folder cannot be written, the disk is full.
    """
    seed = scenario.seed if seed is None else seed
    backend = backend or mujoco_backend()
    progress = progress or (lambda step, done, total: None)
    if out_dir is not None:
        check_free(out_dir)
    meta = _provenance(scenario, seed, backend)
    store = FolderCache(cache_dir)
    # Inertial readings change no frame.
    provenance = _provenance(scenario.model_copy(update={"imu": None}), seed, backend)
    key = content_key({"depth": depth, "sources": _sources(), **provenance})
    entry = store.find(key)
    if entry is None:
        with store.create(key) as folder:
            _render_into(folder, scenario, seed, depth, backend, store, progress)
        entry = store.root / key
    sequence = _open(entry, scenario, meta)
    if out_dir is not None:
        write_tum(sequence, out_dir, depth=depth, progress=progress)
    return sequence


def _render_into(
    folder: Path,
    scenario: Scenario,
    seed: int,
    depth: bool,
    backend: RenderBackend,
    store: FolderCache,
    progress: Progress,
) -> None:
    """Write the frames and the truth of a sequence into a folder of the cache."""
    camera = scenario.camera
    if any(isinstance(segment, ImageSegment) for segment in scenario.segments):
        entry = _clean_frames_of(scenario, seed, backend, store, progress)
        view_share = np.load(entry / "view_share.npy")
        plan = plan_in_world(scenario, seed, backend, view_share.shape[1], lambda plan: view_share)
        clean_frames = nullcontext(stored_clean_frames(entry))
    else:
        plan, world = plan_frames(scenario, seed, backend, progress)
        clean_frames = rendered_clean_frames(world, camera, backend)
    own = camera_intrinsics(camera)
    chain = ImageChain(
        scenario.segments,
        own,
        plan.stamps_s,
        plan.frame,
        seed,
        exposure_s=plan.exposure_s,
        ideal=ideal_camera(own),
    )
    with clean_frames as source:
        blur_px = expose_frames(folder, plan, source, camera, chain, depth, progress)
    _write_truth(folder, scenario, plan, chain, blur_px)


def _clean_frames_of(
    scenario: Scenario, seed: int, backend: RenderBackend, store: FolderCache, progress: Progress
) -> Path:
    """Return the folder of a scenario's clean frames; render them if they are not cached."""
    kept = [s for s in scenario.segments if DEGRADATIONS[s.kind].stage in (Stage.MOTION, Stage.WORLD)]
    clean = scenario.model_copy(
        update={
            "name": "clean_frames",
            "description": "",
            "imu": None,
            "segments": tuple(in_order_of_action(kept)),
            "camera": scenario.camera.model_copy(update={"exposure_s": 0.0, "noise_sigma": 0.0}),
        }
    )
    key = content_key({"clean_frames": True, "sources": _sources(), **_provenance(clean, seed, backend)})
    entry = store.find(key)
    if entry is None:
        plan, world = plan_frames(clean, seed, backend, progress)
        with (
            store.create(key) as folder,
            rendered_clean_frames(world, clean.camera, backend) as clean_frames,
        ):
            store_clean_frames(folder, plan, clean_frames, clean.camera, progress)
        entry = store.root / key
    return entry


def _write_truth(
    folder: Path, scenario: Scenario, plan: FramePlan, chain: ImageChain, blur_px: np.ndarray
) -> None:
    truths, measured = truths_of(scenario.segments, plan, chain, blur_px)
    # Every frame has an exposure and some blur, with or without a segment.
    columns = {**measured, "exposure_s": plan.exposure_s, "blur_px": blur_px}
    (folder / "segments.json").write_text(json.dumps([asdict(truth) for truth in truths]))
    np.save(folder / "stamps_s.npy", plan.stamps_s + plan.stamp_error_s)
    np.save(folder / "T_world_cam.npy", plan.motion.T_world_cam(plan.stamps_s))
    np.savez(folder / "frame_truth.npz", **columns)


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
        segments=tuple(SegmentTruth.from_record(segment) for segment in segments),
        meta=meta,
        frame_truth=columns,
    )


def _provenance(scenario: Scenario, seed: int, backend: RenderBackend) -> dict[str, Any]:
    """Everything on which the frames depend, as JSON-like data."""
    return {
        "spec": scenario.model_copy(update={"seed": seed}).model_dump(mode="json"),
        "seed": seed,
        "versions": {"python": platform.python_version(), **_versions()},
        "renderer": backend.renderer_name,
        "gl": backend.gl_info(),
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
    """Hash of every source file that can change a pixel; part of the cache key."""
    digest = hashlib.sha256()
    for root in (Path(str(scenarios.__file__)).parent, Path(__file__).parent):
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _sources() -> dict[str, str]:
    """Digests of the sources of the packages and of the registered extensions."""
    return {"packages": _source_hash(), **extension_digests()}
