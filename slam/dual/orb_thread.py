"""Recovery thread 1: ORB tracking with a motion model, backward. Source: paper, Algorithm 1, lines 3-13."""

from slam.dual.fusion import Alignment, agree, align
from slam.dual.recovery import RecoveryConfig, RecoveryResult, RecoveryTask
from slam.frame import Frame
from slam.local_mapping import LocalMapper
from slam.map import Map
from slam.timing import StageTimer
from slam.tracking import Tracker


class OrbRecovery:
    """The base system's tracking and mapping, run against time."""

    name = "orb"

    def __init__(self, config: RecoveryConfig) -> None:
        self.config = config

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Track the buffered frames newest first, map as forward mapping does, try to meet the old map."""
        result = RecoveryResult(task.new_map)
        tracker = Tracker(task.new_map, self.config.tracking, StageTimer())
        tracker.start(task.first, task.first.reference_keyframe, task.step)
        mapper = LocalMapper(task.new_map, self.config.mapping)
        meeting = _Meeting(task, self.config)
        unusable_since_s = None
        for features in task.backward:
            frame = Frame(features)
            result.frames_covered += 1
            outcome = tracker.track(frame)
            if not outcome.success:
                result.frames_passed_over += 1
                if unusable_since_s is None:
                    unusable_since_s = features.stamp_s
                if unusable_since_s - features.stamp_s >= self.config.max_unusable_s:
                    result.stage, result.reason = "propagation", outcome.reason
                    return result
                tracker.pass_over(frame)
                continue
            unusable_since_s = None
            result.inliers = outcome.inliers
            result.frames.append(frame)
            if meeting.possible(frame) or tracker.wants_keyframe(frame, outcome.inliers):
                keyframe = mapper.insert(frame)
                tracker.keyframe_made(frame, keyframe)
                if meeting.attempt(frame, keyframe):
                    result.success = True
                    result.alignment = meeting.accepted
                    result.inliers = meeting.accepted.inliers
                    return result
        result.stage, result.reason = meeting.verdict()
        return result


class _Meeting:
    """Watches for the old map: aligns where the two maps have keyframes of the same time."""

    def __init__(self, task: RecoveryTask, config: RecoveryConfig) -> None:
        self._task = task
        self._config = config.fusion
        old: Map = task.old_map
        self._old_keyframes = {old.frame_index(int(k)): int(k) for k in old.keyframes()}
        self._found: list[Alignment] = []
        self._failures: list[tuple[str, int]] = []

    @property
    def accepted(self) -> Alignment:
        """The alignment that was confirmed last."""
        return self._found[-1]

    def possible(self, frame: Frame) -> bool:
        """Whether the old map has a keyframe of this very frame."""
        return frame.features.index in self._old_keyframes

    def attempt(self, frame: Frame, keyframe: int) -> bool:
        """Align at this keyframe; True once enough alignments agree."""
        index = frame.features.index
        near = [f for f in self._old_keyframes if abs(f - index) <= self._config.max_frame_gap]
        if not near:
            return False
        old_keyframe = self._old_keyframes[min(near, key=lambda f: abs(f - index))]
        task = self._task
        alignment, reason, count = align(
            task.old_map, task.new_map, old_keyframe, keyframe, task.rng, self._config
        )
        if alignment is None:
            self._failures.append((reason, count))
            return False
        self._found.append(alignment)
        agreeing = [a for a in self._found[:-1] if agree(task.old_map, a, alignment, self._config)]
        return len(agreeing) + 1 >= self._config.confirmations

    def verdict(self) -> tuple[str, str]:
        """(stage, reason) of a failure to meet."""
        if self._found:
            return "sim3", "alignments_do_not_agree" if len(self._found) > 1 else "alignment_not_confirmed"
        if any(reason == "sim3" for reason, _ in self._failures):
            return "sim3", "too_few_inliers"
        return "overlap", "too_few_common_points" if self._failures else "old_map_not_reached"
