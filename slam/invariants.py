"""What is always true of a system between two frames, whatever it has been through, and the proof of it."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from slam.core import events as ev
from slam.core.events import Event, TrackingState
from slam.core.frame import Frame
from slam.core.results import TrackingResult
from slam.dual.dual_slam import DualSlam
from slam.map.invariants import InvariantError, check_map, require, require_rigid
from slam.map.map import Map
from slam.system import MonocularSlam

__all__ = ["InvariantError", "check_events", "check_map", "check_result", "check_system"]


def check_system(system: MonocularSlam) -> None:
    """Prove the invariants of a whole system: maps, poses of frames, tracker and mapper, buffer, events.

    It reads and changes nothing. Of a threaded system it may be asked only when nothing is under way.

    Raises:
        InvariantError: naming the first that does not hold.
    """
    for map_id in sorted(system.maps()):
        m = system.map(map_id)
        try:
            check_map(m)
            _check_one_tree(m)
            _check_frame_numbers(system, m)
            _check_poses(system, map_id, m)
        except InvariantError as error:
            raise InvariantError(f"map {map_id}: {error}") from None
    _check_whereabouts(system)
    _check_belongings(system)
    if isinstance(system, DualSlam):
        _check_dual(system)
    check_events(system.events)
    _check_counts(system)


def check_result(result: TrackingResult) -> None:
    """Prove that an answer holds together: a rigid pose while tracking and else none, a mark per keypoint.

    Raises:
        InvariantError: naming what does not hold.
    """
    at = f"the answer to frame {result.frame}"
    tracked = result.state is TrackingState.TRACKING
    require((result.T_map_cam is not None) == tracked, f"{at}: {result.state}, and a pose or none")
    if result.T_map_cam is not None:
        require_rigid(result.T_map_cam[None], f"{at}: the pose")
        require(not result.reason, f"{at}: tracked, and a reason why not")
    require(len(result.inlier_mask) == len(result.keypoints_px), f"{at}: keypoints and marks disagree")


def check_events(events: Sequence[Event]) -> None:
    """Prove that events tell a story that can be: in order, of maps and recoveries that there were.

    Raises:
        InvariantError: naming the first event that cannot be.
    """
    stamps: dict[int, float] = {}
    maps: set[int] = set()
    running: set[tuple[int, int]] = set()
    sought = False
    latest = 0
    for event in events:
        named = f"{event.kind} at frame {event.frame}"
        require(event.frame >= 0 and np.isfinite(event.stamp_s), f"{named} is at no frame")
        require(stamps.setdefault(event.frame, event.stamp_s) == event.stamp_s, f"{named} has another time")
        if not isinstance(event, ev.LoopClosed | ev.MapAdjusted):
            # What loop closing brings about counts for the keyframe that set it off.
            require(event.frame >= latest, f"{named} comes after one of frame {latest}")
            latest = event.frame
        if isinstance(event, ev.Initialized):
            require(event.map_id not in maps, f"{named}: there is a map {event.map_id} already")
            maps.add(event.map_id)
        elif isinstance(event, ev.ReinitStart):
            sought = True
        elif isinstance(event, ev.ReinitDone):
            require(sought and event.map_id in maps, f"{named}: no map was sought")
            sought = False
        else:
            require(event.map_id in maps, f"{named}: there is no map {event.map_id}")
        if isinstance(event, ev.RecoveryStart | ev.RecoveryEnd):
            require(event.old_map_id in maps, f"{named}: there is no old map {event.old_map_id}")
            thread = (event.map_id, event.thread)
            started = isinstance(event, ev.RecoveryStart)
            require(
                started != (thread in running), f"{named}: the recovery {'runs' if started else 'does not'}"
            )
            running ^= {thread}
        elif isinstance(event, ev.Fusion):
            require(event.old_map_id in maps, f"{named}: there is no old map {event.old_map_id}")
            require(not event.accepted or event.scale > 0, f"{named}: scale {event.scale:g}")
            taken_in = event.record().get("new_map_id", event.map_id)
            if event.accepted and taken_in != event.old_map_id:
                require(taken_in in maps, f"{named}: there is no new map {taken_in}")
                maps.remove(taken_in)
        elif isinstance(event, ev.MapDropped):
            maps.remove(event.map_id)
    in_order = [stamps[frame] for frame in sorted(stamps)]
    require(all(a < b for a, b in pairwise(in_order)), "events run against time")


# -- maps ------------------------------------------------------------------------------------------------


def _check_one_tree(m: Map) -> None:
    roots = [k for k in range(m.n_keyframes) if m.parent(k) < 0]
    require(len(roots) == 1, f"the spanning tree has {len(roots)} roots")


def _check_frame_numbers(system: MonocularSlam, m: Map) -> None:
    numbers = [m.frame_index(k) for k in range(m.n_keyframes)]
    require(all(0 <= n < system.frames for n in numbers), "a keyframe of a frame that has not been")


def _check_poses(system: MonocularSlam, map_id: int, m: Map) -> None:
    """Every pose of a frame hangs on a keyframe that exists, and follows time."""
    poses = system._poses._poses.get(map_id, {})
    require(poses, "no frame has a pose")
    require(all(0 <= n < system.frames for n in poses), "a pose of a frame that has not been")
    keyframes = np.array([pose.keyframe for pose in poses.values()])
    require(
        ((keyframes >= 0) & (keyframes < m.n_keyframes)).all(), "a pose on a keyframe that does not exist"
    )
    require_rigid(np.array([pose.T_cam_keyframe for pose in poses.values()]), "the pose of a frame")
    stamps = [poses[n].stamp_s for n in sorted(poses)]
    require(all(a < b for a, b in pairwise(stamps)), "poses run against time")


# -- the system ------------------------------------------------------------------------------------------


def _check_whereabouts(system: MonocularSlam) -> None:
    """Tracker and mapper work in the current map, which there is unless one is being sought."""
    current = system.current_map_id
    if system.state is TrackingState.NOT_INITIALIZED:
        require(current not in system.maps(), "a new map is sought under the number of one that exists")
        return
    require(current in system.maps(), "the current map does not exist")
    m = system.current_map
    require(system.tracker.map is m, "the tracker works in another map")
    require(system.mapper.map is m, "the mapper works in another map")
    young = system.mapper._young
    require(((young >= 0) & (young < m.n_points)).all(), "the mapper watches a point that does not exist")
    if system.state is TrackingState.TRACKING:
        _check_last(system.tracker.last, m)
        velocity = system.tracker.velocity
        require(velocity is None or np.isfinite(velocity).all(), "the tracker's velocity is not finite")


def _check_last(last: Frame | None, m: Map) -> None:
    if last is None:
        raise InvariantError("the tracker has no last frame")
    require(0 <= last.reference_keyframe < m.n_keyframes, "the last frame hangs on no keyframe")
    require(((last.point >= -1) & (last.point < m.n_points)).all(), "the last frame matches no point")
    require_rigid(last.T_cam_reference[None], "the last frame's pose")


def _check_belongings(system: MonocularSlam) -> None:
    """What is kept beside the maps is kept of maps that exist."""
    for map_id in system.maps():
        require(system.map(map_id).map_id == map_id, f"map {map_id} has another number")
    require(set(system._poses._poses) <= set(system.maps()), "poses of a map that does not exist")
    for map_id, places in system._known_places.items():
        require(map_id in system.maps(), f"places of map {map_id}, which does not exist")
        right = places.loops.map is places.relocalizer.map is system.map(map_id)
        require(right, f"places of map {map_id} are those of another one")


def _check_dual(system: DualSlam) -> None:
    saved, frames = system._saved, list(system._buffer._frames)
    require(len(set(saved)) == len(saved), "a map is saved twice")
    require(set(saved) <= set(system.maps()), "a saved map does not exist")
    if system.state is TrackingState.TRACKING:
        require(system.current_map_id not in saved, "the current map is a saved one")
    require(all(a.index < b.index for a, b in pairwise(frames)), "the buffer is out of order")
    require(all(a.stamp_s < b.stamp_s for a, b in pairwise(frames)), "the buffer runs against time")
    if system.frames:
        require(frames and frames[-1].index == system.frames - 1, "the buffer lacks the newest frame")
        span_s = frames[-1].stamp_s - frames[0].stamp_s
        require(span_s <= system._buffer.cap_s, "the buffer has outgrown its cap")


def _check_counts(system: MonocularSlam) -> None:
    """Every map was initialized, and only a drop or a fusion takes one away."""
    events = system.events
    require(all(event.frame < system.frames for event in events), "an event of a frame that has not been")
    begun = sum(isinstance(event, ev.Initialized) for event in events)
    dropped = sum(isinstance(event, ev.MapDropped) for event in events)
    fused = sum(isinstance(event, ev.Fusion) and event.accepted for event in events)
    there = len(system.maps())
    require(
        begun - dropped - fused == there,
        f"{begun} maps begun, {dropped} dropped, {fused} fused: {there} left",
    )
