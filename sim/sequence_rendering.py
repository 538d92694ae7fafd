"""From a scenario and a seed to a sequence: frames and truth."""

import json
import math
from collections.abc import Sequence as Many
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import read_json
from dslab.scenarios.segments import ImageSegment, Segment
from dslab.scenarios.spec import Scenario
from dslab.sim.cache import CorruptEntryError, FolderCache
from dslab.sim.degradations.base import FramePlan, Stage
from dslab.sim.degradations.registry import DEGRADATIONS, IMAGE_KINDS, in_order_of_action
from dslab.sim.degradations.truth import truths_of
from dslab.sim.frame_plan import (
    Progress,
    RenderBackend,
    camera_intrinsics,
    plan_frames,
    plan_in_world,
    quiet,
    render_backend,
)
from dslab.sim.imaging import ImagingChain, KeptExposures, SharedExposures, rendered
from dslab.sim.io.folders import check_free
from dslab.sim.io.raw import RawFrames, RawWriter, stored_array, stored_columns
from dslab.sim.io.tum import write_tum
from dslab.sim.provenance import entry_key, provenance
from dslab.sim.room import Need, check_room, images_need
from dslab.sim.sequence import SegmentTruth, Sequence

_NO_SENSOR = {"noise_sigma": 0.0, "shot_noise": 0.0, "softness_px": 0.0, "contrast": 1.0}
_VIEW_SHARE, _MEASURES = "view_share.npy", "measures.npy"


def render_sequence(
    scenario: Scenario,
    seed: int | None = None,
    *,
    out_dir: Path | None = None,
    cache_dir: Path | None = None,
    depth: bool = False,
    first_s: float | None = None,
    progress: Progress | None = None,
    backend: RenderBackend | None = None,
    needs: Many[Need] = (),
    force: bool = False,
) -> Sequence:
    """Render a scenario, or read it from the cache.

    The same scenario and seed give the same bytes on one machine and GL driver. Frames stay on disk and are
    read one by one. If segments act on images only behind the lens, or noise has a seed of its own, the
    frames before them are cached too: another severity, or noise, renders nothing again.

    Args:
        scenario: what happens.
        seed: root seed; None for the scenario's own.
        out_dir: also write the sequence there as a TUM-form folder.
        cache_dir: folder of the cache; None for the default one.
        depth: render and keep depth images too, four times as large as the frames.
        first_s: render only the frames of the first seconds, as they are in the whole; None for all.
        progress: called after every frame.
        backend: worlds and renderer; None for MuJoCo.
        needs: what the caller will write of the sequence, so that its room is checked beforehand too.
        force: begin even if disks and memory seem too small, or the frames are very many.

    Raises:
        InputError: no GL, the world's sizes do not fit, there is no room for the frames, a folder cannot be
            written, the disk is full.
    """
    if seed is not None:
        scenario = scenario.model_copy(update={"seed": seed})
    backend, progress, store = backend or render_backend(), progress or quiet, FolderCache(cache_dir)
    begun_s = None if first_s is None or first_s >= scenario.duration_s else first_s
    count, kept = _frames_within(scenario, begun_s), _keeps_exposed_frames(scenario) and not depth
    if out_dir is not None:
        check_free(out_dir)
        needs = [*needs, images_need_of(scenario, out_dir, depth)]
    opened = partial(_open, scenario=scenario, meta=provenance(scenario, backend), depth=depth)
    # An entry of the whole, or with depth, has the same frames.
    kinds = ({"depth": depth, "first_s": begun_s}, {"depth": depth}, {"depth": True})
    keys = [entry_key(scenario, backend, **kind) for kind in kinds]
    found = (store.load(key, opened) for key in dict.fromkeys(keys))
    sequence = next((sequence for sequence in found if sequence is not None), None)
    if sequence is None:
        frames = (5 if depth else 1) * count + (scenario.frame_count if kept else 0)
        needs = [*needs, Need(store.root, frames * scenario.camera.width_px * scenario.camera.height_px)]
    check_room(scenario.name, count, needs, force)
    if sequence is None:
        with store.create(keys[0]) as folder:
            exposed = _exposed_frames_of(scenario, backend, store, progress) if kept else None
            _render_into(folder, scenario, backend, progress, exposed, depth=depth, first_s=begun_s)
        sequence = opened(store.root / keys[0])
    if first_s is not None:
        sequence = sequence.first(first_s)
    if out_dir is not None:
        write_tum(sequence, out_dir, depth=depth, progress=progress)
    return sequence


def images_need_of(scenario: Scenario, out_dir: Path, depth: bool = False) -> Need:
    """What a scenario needs as a sequence folder, at worst."""
    camera = scenario.camera
    return images_need(out_dir, scenario.frame_count, (camera.width_px, camera.height_px), depth)


def _frames_within(scenario: Scenario, first_s: float | None) -> int:
    """The most frames in the first seconds, or in all."""
    count = scenario.frame_count
    return count if first_s is None else min(count, math.ceil(first_s * scenario.camera.fps) + 1)


def _keeps_exposed_frames(scenario: Scenario) -> bool:
    """Return True if noise or a stress behind the lens may vary, and before the lens none acts by chance."""
    kinds = [IMAGE_KINDS[s.kind] for s in scenario.segments if isinstance(s, ImageSegment)]
    by_chance = any(kind.stage < Stage.LENS and kind.is_drawn for kind in kinds)
    behind = any(kind.stage >= Stage.LENS for kind in kinds)
    return not by_chance and (behind or scenario.noise_seed is not None)


def _acts_before_the_lens(segment: Segment) -> bool:
    """Return True for a segment that is in the exposed frames, if these are kept."""
    stage = DEGRADATIONS[segment.kind].stage
    return stage <= Stage.SHUTTER or Stage.SCENE <= stage < Stage.LENS


def _exposed_frames_of(
    scenario: Scenario, backend: RenderBackend, store: FolderCache, progress: Progress
) -> KeptExposures:
    """The exposed frames of a scenario; they are rendered if they are not cached."""
    kept = filter(_acts_before_the_lens, scenario.segments)
    bare = scenario.model_copy(
        update={
            "name": "exposed_frames",
            "description": "",
            "noise_seed": None,
            "segments": tuple(in_order_of_action(kept)),
            "camera": scenario.camera.model_copy(update=_NO_SENSOR),
        }
    )
    alike = bare.model_copy(update={"segments": ()})
    key, shared = (entry_key(one, backend, exposed_frames=True) for one in (bare, alike))
    read = partial(_read_exposed_frames, scenario=bare)
    found = store.load(key, read)
    if found is None:
        with store.create(key) as folder:
            plan, chain = _render_into(folder, bare, backend, progress, shared=f"{store.root} {shared}")
            np.save(folder / _VIEW_SHARE, plan.view_share)
            if measures := [link.measure for link in chain.segments]:
                np.save(folder / _MEASURES, measures)
        found = read(store.root / key)
    return found


def _read_exposed_frames(entry: Path, scenario: Scenario) -> KeptExposures:
    """The exposed frames of an entry. Raises CorruptEntryError if it holds anything else."""
    camera, count = scenario.camera, scenario.frame_count
    columns = stored_columns(entry / "frame_truth.npz", count)
    if "blur_px" not in columns:
        raise CorruptEntryError("frame_truth.npz has no blur_px")
    acted = [segment for segment in scenario.segments if isinstance(segment, ImageSegment)]
    stored = stored_array(entry / _MEASURES, (len(acted), count), np.float64) if acted else ()
    return KeptExposures(
        RawFrames(entry / "gray.npy", (count, camera.height_px, camera.width_px), np.uint8),
        columns["blur_px"],
        np.array(stored_array(entry / _VIEW_SHARE, (count, None), np.float32)),
        dict(zip(acted, np.array(stored), strict=True)),
    )


def _render_into(
    folder: Path,
    scenario: Scenario,
    backend: RenderBackend,
    progress: Progress,
    exposed: KeptExposures | None = None,
    depth: bool = False,
    first_s: float | None = None,
    shared: str = "",
) -> tuple[FramePlan, ImagingChain]:
    """Write the frames and the truth of a sequence into a folder of the cache; return its plan and segments.

    ``shared``, for exposed frames, is the key of those without segments: frames that look alike are shared.
    """
    camera, world = scenario.camera, None
    if exposed:
        view_share = exposed.view_share
        plan = plan_in_world(scenario, backend, view_share.shape[1], lambda plan: view_share)
    else:
        plan, world = plan_frames(scenario, backend, progress)
    if first_s is not None:
        plan = plan.first(first_s)
    chain = ImagingChain(camera, scenario.segments, plan, scenario.seed_of_noise)
    count, size = len(plan.frame), (camera.height_px, camera.width_px)
    with ExitStack() as files:
        if exposed:
            exposed.measure(chain, plan)
            source = [exposed]
        else:
            assert world is not None
            source = [*files.enter_context(rendered(world, chain.ideal, backend)), *chain.to_lens]
            source = [SharedExposures(source, chain, shared, plan)] if shared else source
        grays = files.enter_context(RawWriter(folder / "gray.npy", (count, *size), np.uint8))
        depths = RawWriter(folder / "depth.npy", (count, *size), np.float32) if depth else None
        depths = depths and files.enter_context(depths)
        for index, (image, depth_m) in enumerate(chain.images(source), start=1):
            grays.append(image)
            if depths:
                depths.append(depth_m)
            progress("degrading" if exposed else "exposing", index, count)
    blur_px = chain.exposure.blur_px
    truths, measured = truths_of(scenario.segments, plan, chain.segments, blur_px)
    (folder / "segments.json").write_text(json.dumps([asdict(truth) for truth in truths]))
    np.save(folder / "stamps_s.npy", plan.stamps_s + plan.stamp_error_s)
    np.save(folder / "T_world_cam.npy", plan.motion.T_world_cam(plan.stamps_s))
    # Every frame has an exposure and some blur, with or without a segment.
    columns = {**measured, "exposure_s": plan.exposure_s, "blur_px": blur_px}
    np.savez(folder / "frame_truth.npz", **columns)
    return plan, chain


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
