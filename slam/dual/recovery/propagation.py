"""Backward propagation over the buffer, shared by all recovery threads.

Source: paper, Sec. III-B and Algorithm 1.
"""

from dslab.slam.core.events import CANCELLED
from dslab.slam.core.frame import Frame
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.overlap import Doubt, Overlap
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.tracking.tracker import Tracker


def propagate(
    task: RecoveryTask,
    config: RecoveryConfig,
    tracker: Tracker,
    mapper: LocalMapper,
    doubt: Doubt | None = None,
) -> RecoveryResult:
    """Track the buffered frames newest first, map them, align with the old maps.

    Args:
        task: input; its new map is extended in place.
        config: settings.
        tracker: estimates poses in the new map; started at the task's first frame.
        mapper: extends the new map.
        doubt: what else may speak against an alignment, asked when nothing in the maps does.
    """
    result = RecoveryResult(task.new_map)
    overlap = Overlap(task, config.fusion, config.at_once, doubt)
    unusable_since_s = None
    for features in task.backward:
        if task.cancellation.requested:
            result.stage = CANCELLED
            return result
        frame = Frame(features)
        result.frames_covered += 1
        outcome = tracker.track(frame)
        if not outcome.success:
            result.frames_passed_over += 1
            if unusable_since_s is None:
                unusable_since_s = features.stamp_s
            if unusable_since_s - features.stamp_s >= config.max_unusable_s:
                result.stage, result.reason = "propagation", outcome.reason
                return result
            tracker.pass_over(frame)
            continue
        if tracker.doubt.reason:
            result.stage, result.reason = "propagation", tracker.doubt.reason
            return result
        unusable_since_s = None
        result.inliers = outcome.inliers
        result.frames.append(frame)
        if overlap.is_old_keyframe(frame) or tracker.wants_keyframe(frame, outcome.inliers):
            keyframe = mapper.insert(frame)
            result.keyframes_made += 1
            tracker.keyframe_made(frame, keyframe)
            confirmed = overlap.attempt(frame, keyframe)
            result.alignments_tried = overlap.tried
            if confirmed and not config.whole_buffer:
                break
    overlap.compare_all()
    result.alignments_tried = overlap.tried
    if overlap.accepted is None:
        result.stage, result.reason = overlap.verdict()
    else:
        result.success, result.inliers = True, overlap.accepted.inliers
        result.alignment, result.confirming = overlap.accepted, overlap.confirming
    return result
