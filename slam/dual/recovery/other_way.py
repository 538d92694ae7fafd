"""The gap crossed the other way, from the old map to the new one, as a check of the first crossing.

A map that drifts while it is carried through what can hardly be seen is sound at either end: where it meets
the old map nothing speaks against it. It drifts along its way, though: a map that shrinks on its way back
shrinks on its way ahead too, and the two then disagree about where the new map begins, by twice the error of
each.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.core.events import CANCELLED
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import camera_centre, share_of_motion
from dslab.slam.core.settings import DEPTHS, setting, settings
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.tracks import TrackTracker
from dslab.slam.loop_closing.map_alignment import Alignment, align
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_decompose


@settings
class OtherWayConfig:
    """By how much the two ways may disagree."""

    check: bool = setting(True, "cross the gap the other way at all")
    max_shift: float = setting(0.12, "distance of the two places of the new map's first frame", unit=DEPTHS)
    max_rotation_deg: float = setting(4.0, "angle between the two orientations of the new map's first frame")
    max_scale_change: float = setting(0.1, "change of scale between the two ways, where it can be told")


def objection_of_other_way(
    task: RecoveryTask,
    result: RecoveryResult,
    config: RecoveryConfig,
    bounds: OtherWayConfig,
    tracker_of: Callable[[RecoveryTask], TrackTracker],
) -> str:
    """Go from the old map to the new map's first frame, and compare.

    Args:
        task, result: of a recovery that has succeeded; its costs grow by those of the other way.
        config: the thread's settings.
        bounds: by how much the ways may disagree.
        tracker_of: makes the thread's tracker, which goes the other way too.

    Returns:
        Empty if both ways agree; ``not_found_back`` if the other way does not arrive, ``ways_disagree`` if it
        arrives elsewhere; ``cancelled`` if the thread was ended meanwhile.
    """
    found = result.alignment
    assert found is not None
    ahead = _task_ahead(task, found)
    if ahead is None:
        return "not_found_back"
    tracker = tracker_of(ahead)
    mapper = tracker.mapper(ahead, ahead.first.reference_keyframe)
    unusable_since_s = None
    last = ahead.backward[-1]
    for features in ahead.backward:
        if task.cancellation.requested:
            return CANCELLED
        frame = Frame(features)
        result.frames_checked += 1
        outcome = tracker.track(frame)
        if outcome.success and not tracker.doubt.reason:
            unusable_since_s = None
            if features is last or tracker.wants_keyframe(frame, outcome.inliers):
                tracker.keyframe_made(frame, mapper.insert(frame))
                result.keyframes_made += 1
            continue
        unusable_since_s = features.stamp_s if unusable_since_s is None else unusable_since_s
        too_long = features.stamp_s - unusable_since_s >= config.max_unusable_s
        if features is last or too_long or tracker.doubt.reason:
            return "not_found_back"
        tracker.pass_over(frame)
    return _disagreement(task, found, ahead.new_map, tracker, config, bounds)


def _task_ahead(task: RecoveryTask, found: Alignment) -> RecoveryTask | None:
    """The crossing from the old map's keyframe at the meeting ahead to the new map's first frame."""
    old = next(m for m in task.old_maps if m.map_id == found.old_map_id).copy()
    held = {features.index for features in task.backward}
    keyframes = [int(k) for k in old.keyframes() if old.frame_index(int(k)) in held]
    reached = old.frame_index(found.old_keyframe)
    keyframes.sort(key=lambda k: (abs(old.frame_index(k) - reached), k))
    if not keyframes:
        return None
    start = Frame(old.features(keyframes[0]))
    start.T_cam_map, start.T_cam_reference = old.T_cam_map(keyframes[0]).copy(), np.eye(4)
    start.point[:], start.reference_keyframe = old.observed_points(keyframes[0]), keyframes[0]
    frames = [features for features in reversed(task.backward) if features.index > start.features.index]
    return replace(
        task,
        new_map=old,
        first=start,
        backward=(*frames, task.first.features),
        old_maps=(task.new_map,),
        step=_step_at(old, keyframes[0]),
    )


def _step_at(m: Map, keyframe: int) -> np.ndarray:
    """(4, 4) motion of one frame, from the keyframe before this one in time; none if it is the first."""
    index = m.frame_index(keyframe)
    before = [k for k in map(int, m.keyframes()) if m.frame_index(k) < index]
    if not before:
        return np.eye(4)
    nearest = max(before, key=m.frame_index)
    moved = m.T_cam_map(keyframe) @ np.linalg.inv(m.T_cam_map(nearest))
    return share_of_motion(moved, 1 / (index - m.frame_index(nearest)))


def _disagreement(
    task: RecoveryTask,
    found: Alignment,
    old: Map,
    tracker: TrackTracker,
    config: RecoveryConfig,
    bounds: OtherWayConfig,
) -> str:
    new, first = task.new_map, task.first
    scale, R, t = sim3_decompose(found.S_old_new)
    T_new = first.T_cam_reference @ new.T_cam_map(new.live(first.reference_keyframe))
    T_ahead = tracker.pose_of(tracker.latest.frame)
    place = scale * R @ camera_centre(T_new) + t
    shift = np.linalg.norm(camera_centre(T_ahead) - place) / max(tracker.latest.depth, 1e-9)
    turned = np.rad2deg(Rotation.from_matrix(T_new[:3, :3] @ R.T @ T_ahead[:3, :3].T).magnitude())
    if shift > bounds.max_shift or turned > bounds.max_rotation_deg:
        return "ways_disagree"
    keyframe = tracker.latest.frame.reference_keyframe
    if new.frame_index(first.reference_keyframe) == first.features.index:
        there, _, _ = align(old, new, keyframe, first.reference_keyframe, task.rng, config.fusion)
        if (
            there is not None
            and abs(np.log(sim3_decompose(there.S_old_new)[0] / scale)) > bounds.max_scale_change
        ):
            return "ways_disagree"
    return ""
