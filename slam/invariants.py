"""Invariants of a system between two frames and their check."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dslab.slam.core import events as ev
from dslab.slam.core.events import Event, TrackingState
from dslab.slam.core.frame import Frame
from dslab.slam.core.results import TrackingResult
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.ldso.invariants import check_direct_maps
from dslab.slam.ldso.system import DsoSlam
from dslab.slam.map.invariants import InvariantError, check_map, require, require_rigid
from dslab.slam.map.map import Map
from dslab.slam.system import MonocularSystem

__all__ = ["InvariantError", "check_events", "check_map", "check_result", "check_system"]


def check_system(system: MonocularSystem | DsoSlam) -> None:
    """Check the invariants of a whole system: maps, frame poses, tracker and mapper, buffer, events.

    The system is not changed. A threaded system must be idle.

    Raises:
        InvariantError: the first violated one.
    """
    if isinstance(system, DsoSlam):
        check_direct_maps(system)
    else:
        _check_feature_maps(system)
    check_events(system.events)
    _check_counts(system)


def _check_feature_maps(system: MonocularSystem) -> None:
    for map_id in sorted(system.maps()):
        m = system.map(map_id)
        try:
            check_map(m)
            _check_one_tree(m)
            _check_frame_numbers(system, m)
            _check_poses(system, map_id, m)
        except InvariantError as error:
            raise InvariantError(f"map {map_id}: {error}") from None
    _check_current_map(system)
    _check_map_ids(system)
    if isinstance(system, DualSlam):
        _check_dual(system)


def check_result(result: TrackingResult) -> None:
    """Check a frame's result: rigid pose only while tracking, one mask entry per keypoint.

    Raises:
        InvariantError: the first violated invariant.
    """
    at = f"the result of frame {result.frame}"
    tracked = result.state is TrackingState.TRACKING
    require((result.T_map_cam is not None) == tracked, f"{at}: state {result.state} and pose disagree")
    if result.T_map_cam is not None:
        require_rigid(result.T_map_cam[None], f"{at}: the pose")
        require(not result.reason, f"{at}: tracked, with a reason of failure")
    require(len(result.inlier_mask) == len(result.keypoints_px), f"{at}: keypoints and mask disagree")


def check_events(events: Sequence[Event]) -> None:
    """Check that events are in order of time, and of existing maps and recoveries.

    Raises:
        InvariantError: the first inconsistent event.
    """
    stamps: dict[int, float] = {}
    maps: set[int] = set()
    known: set[int] = set()  # also those dropped or fused: a recovery or a probation may end after its map
    running: set[tuple[int, int]] = set()
    reinitializing = False
    latest = 0
    for event in events:
        named = f"{event.kind} at frame {event.frame}"
        require(event.frame >= 0 and np.isfinite(event.stamp_s), f"{named} is at no frame")
        require(stamps.setdefault(event.frame, event.stamp_s) == event.stamp_s, f"{named} has another time")
        if not isinstance(event, ev.LoopClosed | ev.LoopRefused | ev.MapAdjusted | ev.CameraRefined):
            # Events of work on the whole map have the frame of the keyframe that started it.
            require(event.frame >= latest, f"{named} comes after one of frame {latest}")
            latest = event.frame
        if isinstance(event, ev.Initialized):
            require(event.map_id not in maps, f"{named}: map {event.map_id} exists already")
            maps.add(event.map_id)
            known.add(event.map_id)
        elif isinstance(event, ev.ReinitStart):
            reinitializing = True
        elif isinstance(event, ev.ReinitDone):
            require(reinitializing and event.map_id in maps, f"{named}: no reinitialization was started")
            reinitializing = False
        elif isinstance(event, ev.RelocalizationWithdrawn):
            require(event.map_id in known, f"{named}: map {event.map_id} did not exist")
        elif not isinstance(event, ev.RecoveryStart | ev.RecoveryEnd):
            require(event.map_id in maps, f"{named}: map {event.map_id} does not exist")
        if isinstance(event, ev.RecoveryStart | ev.RecoveryEnd):
            require(event.map_id in known, f"{named}: map {event.map_id} did not exist")
            require(event.old_map_id in known, f"{named}: old map {event.old_map_id} does not exist")
            thread = (event.map_id, event.thread)
            started = isinstance(event, ev.RecoveryStart)
            require(
                started != (thread in running), f"{named}: the recovery {'runs' if started else 'does not'}"
            )
            running ^= {thread}
        elif isinstance(event, ev.Fusion):
            existing = maps if event.accepted else known
            require(event.old_map_id in existing, f"{named}: old map {event.old_map_id} does not exist")
            require(not event.accepted or event.scale > 0, f"{named}: scale {event.scale:g}")
            taken_in = event.record().get("new_map_id", event.map_id)
            if event.accepted and taken_in != event.old_map_id:
                require(taken_in in maps, f"{named}: new map {taken_in} does not exist")
                maps.remove(taken_in)
        elif isinstance(event, ev.MapDropped):
            maps.remove(event.map_id)
    in_order = [stamps[frame] for frame in sorted(stamps)]
    require(all(a < b for a, b in pairwise(in_order)), "events run against time")


# -- maps ------------------------------------------------------------------------------------------------


def _check_one_tree(m: Map) -> None:
    roots = [k for k in range(m.n_keyframes) if m.parent(k) < 0]
    require(len(roots) == 1, f"the spanning tree has {len(roots)} roots")


def _check_frame_numbers(system: MonocularSystem, m: Map) -> None:
    numbers = [m.frame_index(k) for k in range(m.n_keyframes)]
    require(all(0 <= n < system.frames for n in numbers), "a keyframe of a future frame")


def _check_poses(system: MonocularSystem, map_id: int, m: Map) -> None:
    """Check that every frame pose refers to an existing keyframe and that times increase."""
    poses = system.engine.store.poses.of(map_id)
    require(poses, "no frame has a pose")
    require(all(0 <= n < system.frames for n in poses), "a pose of a future frame")
    keyframes = np.array([pose.keyframe for pose in poses.values()])
    require(
        ((keyframes >= 0) & (keyframes < m.n_keyframes)).all(), "a pose on a keyframe that does not exist"
    )
    require_rigid(np.array([pose.T_cam_keyframe for pose in poses.values()]), "the pose of a frame")
    stamps = [poses[n].stamp_s for n in sorted(poses)]
    require(all(a < b for a, b in pairwise(stamps)), "poses run against time")


# -- the system ------------------------------------------------------------------------------------------


def _check_current_map(system: MonocularSystem) -> None:
    """Check that tracker and mapper work in the current map, if it is initialized."""
    current = system.current_map_id
    if system.state is TrackingState.NOT_INITIALIZED:
        require(current not in system.maps(), "the new map has the id of an existing one")
        return
    require(current in system.maps(), "the current map does not exist")
    m = system.current_map
    require(system.tracker.map is m, "the tracker works in another map")
    require(system.mapper.map is m, "the mapper works in another map")
    young = system.mapper.young
    require(((young >= 0) & (young < m.n_points)).all(), "the mapper watches a point that does not exist")
    if system.state is TrackingState.TRACKING:
        _check_last(system.tracker.last, m)
        velocity = system.tracker.velocity
        require(velocity is None or np.isfinite(velocity).all(), "the tracker's velocity is not finite")


def _check_last(last: Frame | None, m: Map) -> None:
    if last is None:
        raise InvariantError("the tracker has no last frame")
    require(0 <= last.reference_keyframe < m.n_keyframes, "the last frame has no reference keyframe")
    require(((last.point >= -1) & (last.point < m.n_points)).all(), "the last frame matches no point")
    require_rigid(last.T_cam_reference[None], "the last frame's pose")


def _check_map_ids(system: MonocularSystem) -> None:
    """Check that poses and places belong to existing maps."""
    for map_id in system.maps():
        require(system.map(map_id).map_id == map_id, f"map {map_id} has another number")
    require(system.engine.store.poses.maps() <= set(system.maps()), "poses of a map that does not exist")
    for map_id, places in system.engine.store.known_places.items():
        require(map_id in system.maps(), f"places of map {map_id}, which does not exist")
        right = places.loops.map is places.relocalizer.map is system.map(map_id)
        require(right, f"places of map {map_id} are those of another one")


def _check_dual(system: DualSlam) -> None:
    saved, frames = system.engine.store.saved, list(system.buffer)
    require(len(set(saved)) == len(saved), "a map is saved twice")
    require(set(saved) <= set(system.maps()), "a saved map does not exist")
    if system.state is TrackingState.TRACKING:
        require(system.current_map_id not in saved, "the current map is a saved one")
    require(all(a.index < b.index for a, b in pairwise(frames)), "the buffer is out of order")
    require(all(a.stamp_s < b.stamp_s for a, b in pairwise(frames)), "the buffer runs against time")
    if system.frames:
        require(frames and frames[-1].index == system.frames - 1, "the buffer lacks the newest frame")
        span_s = frames[-1].stamp_s - frames[0].stamp_s
        require(span_s <= system.buffer.cap_s, "the buffer has outgrown its cap")


def _check_counts(system: MonocularSystem | DsoSlam) -> None:
    """Check that every map was initialized, and only a drop or a fusion removes one."""
    events = system.events
    require(all(event.frame < system.frames for event in events), "an event of a future frame")
    initialized = sum(isinstance(event, ev.Initialized) for event in events)
    dropped = sum(isinstance(event, ev.MapDropped) for event in events)
    fused = sum(isinstance(event, ev.Fusion) and event.accepted for event in events)
    there = len(system.maps())
    require(
        initialized - dropped - fused == there,
        f"{initialized} maps initialized, {dropped} dropped, {fused} fused: {there} left",
    )
