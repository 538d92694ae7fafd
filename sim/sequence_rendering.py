"""From a scenario and a seed to a sequence: frames and truth."""

import hashlib
import json
import platform
from collections.abc import Callable
from collections.abc import Sequence as Many
from contextlib import nullcontext
from dataclasses import asdict
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import scenarios
from scenarios.errors import InputError
from scenarios.extensions import extension_digests
from scenarios.input_files import read_json
from scenarios.segments import ImageSegment
from scenarios.spec import Scenario
from sim.cache import CorruptEntryError, FolderCache, content_key
from sim.degradations.base import FramePlan, Stage
from sim.degradations.chain import ImageChain
from sim.degradations.registry import DEGRADATIONS, in_order_of_action
from sim.degradations.truths import truths_of
from sim.frame_plan import (
    CleanFrames,
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
from sim.io.raw import RawFrames, stored_array, stored_columns
from sim.io.tum import write_tum
from sim.room import Need, check_room, images_need
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

ContentT = TypeVar("ContentT")

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
    needs: Many[Need] = (),
    force: bool = False,
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
        needs: what the caller will write of the sequence, so that its room is checked beforehand too.
        force: begin even if disks and memory seem too small, or the frames are very many.

    Raises:
        InputError: no GL, the world's sizes do not fit, there is no room for the frames, a folder cannot be
            written, the disk is full.
    """
    seed = scenario.seed if seed is None else seed
    backend = backend or mujoco_backend()
    progress = progress or (lambda step, done, total: None)
    if out_dir is not None:
        check_free(out_dir)
        needs = [*needs, images_need_of(scenario, out_dir, depth)]
    meta = _provenance(scenario, seed, backend)
    store = FolderCache(cache_dir)
    # Inertial readings change no frame.
    provenance = _provenance(scenario.model_copy(update={"imu": None}), seed, backend)
    key = content_key({"depth": depth, "sources": _sources(), **provenance})
    opened = partial(_open, scenario=scenario, meta=meta, depth=depth)
    sequence = _cached(store, key, opened)
    if sequence is None:
        needs = [*needs, Need(store.root, _stacks_bytes(scenario, depth))]
    check_room(scenario.name, scenario.frame_count, needs, force)
    if sequence is None:
        with store.create(key) as folder:
            _render_into(folder, scenario, seed, depth, backend, store, progress)
        sequence = opened(store.root / key)
    if out_dir is not None:
        write_tum(sequence, out_dir, depth=depth, progress=progress)
    return sequence


def images_need_of(scenario: Scenario, out_dir: Path, depth: bool = False) -> Need:
    """What a scenario needs as a sequence folder, at worst."""
    camera = scenario.camera
    return images_need(out_dir, scenario.frame_count, (camera.width_px, camera.height_px), depth)


def _stacks_bytes(scenario: Scenario, depth: bool) -> int:
    """Size of the stacks of frames in the cache: the clean ones have depth, and may be larger for a lens."""
    of_frames = 5 if depth else 1
    of_clean_frames = 5 if _has_image_segments(scenario) else 0
    pixels = scenario.frame_count * scenario.camera.width_px * scenario.camera.height_px
    return pixels * (of_frames + of_clean_frames)


def _has_image_segments(scenario: Scenario) -> bool:
    return any(isinstance(segment, ImageSegment) for segment in scenario.segments)


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
    if _has_image_segments(scenario):
        view_share, stored = _clean_frames_of(scenario, seed, backend, store, progress)
        plan = plan_in_world(scenario, seed, backend, view_share.shape[1], lambda plan: view_share)
        clean_frames = nullcontext(stored)
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
) -> tuple[np.ndarray, CleanFrames]:
    """The survey and clean frames of a scenario; they are rendered if they are not cached."""
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
    stored = partial(stored_clean_frames, count=clean.frame_count, camera=clean.camera)
    found = _cached(store, key, stored)
    if found is None:
        plan, world = plan_frames(clean, seed, backend, progress)
        with (
            store.create(key) as folder,
            rendered_clean_frames(world, clean.camera, backend) as clean_frames,
        ):
            store_clean_frames(folder, plan, clean_frames, clean.camera, progress)
        found = stored(store.root / key)
    return found


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


def _cached(store: FolderCache, key: str, read: Callable[[Path], ContentT]) -> ContentT | None:
    """What a sound entry of the cache holds; None without one. A corrupt one is dropped."""
    entry = store.find(key)
    if entry is None:
        return None
    try:
        return read(entry)
    except CorruptEntryError as fault:
        store.drop(entry, str(fault))
        return None


def _open(entry: Path, scenario: Scenario, meta: dict[str, Any], depth: bool) -> Sequence:
    """The sequence of a cache entry. Raises CorruptEntryError if it is not one of this scenario."""
    camera = camera_intrinsics(scenario.camera)
    stamps_s = np.array(stored_array(entry / "stamps_s.npy", (None,), np.float64))
    count = len(stamps_s)
    shape = (count, camera.height_px, camera.width_px)
    if not 0 < count <= scenario.frame_count or not (np.diff(stamps_s) > 0).all():
        raise CorruptEntryError("stamps_s.npy holds no times of the scenario's frames")
    try:
        records = read_json(entry / "segments.json", list)
        segments = tuple(SegmentTruth.from_record(record, count) for record in records)
    except (InputError, ValueError) as error:
        raise CorruptEntryError(f"segments.json: {error}") from None
    return Sequence(
        name=scenario.name,
        camera=camera,
        stamps_s=stamps_s,
        frames=RawFrames(entry / "gray.npy", shape, np.uint8),
        T_world_cam=np.array(stored_array(entry / "T_world_cam.npy", (count, 4, 4), np.float64)),
        depths=RawFrames(entry / "depth.npy", shape, np.float32) if depth else None,
        segments=segments,
        meta=meta,
        frame_truth=stored_columns(entry / "frame_truth.npz", count),
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
