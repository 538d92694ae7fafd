"""Recovery thread 1: ORB tracking with a motion model, backward. Source: paper, Algorithm 1, lines 3-13."""

from slam.dual.fusion import agree
from slam.dual.recovery import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from slam.frame import Frame
from slam.local_mapping import LocalMapper
from slam.map import Map
from slam.map_alignment import Alignment, align
from slam.timing import StageTimer
from slam.tracking import Tracker


class OrbRecovery:
    """The base system's tracking and mapping, run against time."""

    name = "orb"
    needs_images = False
    cost = RecoveryCost(frame_ms=4.0, keyframe_ms=30.0, alignment_ms=4.0)

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
                result.keyframes_made += 1
                tracker.keyframe_made(frame, keyframe)
                met = meeting.attempt(frame, keyframe)
                result.alignments_tried = meeting.tried
                if met:
                    result.success = True
                    result.alignment = meeting.accepted
                    result.confirming = meeting.confirming
                    result.inliers = meeting.accepted.inliers
                    return result
        result.stage, result.reason = meeting.verdict()
        return result


class _Meeting:
    """Watches for the old maps: aligns where two maps have keyframes of about the same time."""

    def __init__(self, task: RecoveryTask, config: RecoveryConfig) -> None:
        self._task = task
        self._config = config.fusion
        self._keyframes = [
            {old.frame_index(int(k)): int(k) for k in old.keyframes()} for old in task.old_maps
        ]
        self._found: list[Alignment] = []
        self._failures: list[str] = []
        self.tried = 0
        self.confirming: tuple[Alignment, ...] = ()

    @property
    def accepted(self) -> Alignment:
        """The alignment that was confirmed last."""
        return self._found[-1]

    def possible(self, frame: Frame) -> bool:
        """Whether an old map has a keyframe of this very frame."""
        return any(frame.features.index in keyframes for keyframes in self._keyframes)

    def attempt(self, frame: Frame, keyframe: int) -> bool:
        """Align at this keyframe with every old map that it may meet; True once enough alignments agree."""
        index = frame.features.index
        for old, keyframes in zip(self._task.old_maps, self._keyframes, strict=True):
            near = [f for f in keyframes if abs(f - index) <= self._config.max_frame_gap]
            if near and self._align(old, keyframes[min(near, key=lambda f: abs(f - index))], keyframe):
                return True
        return False

    def _align(self, old: Map, old_keyframe: int, keyframe: int) -> bool:
        task = self._task
        self.tried += 1
        alignment, reason, _ = align(old, task.new_map, old_keyframe, keyframe, task.rng, self._config)
        if alignment is None:
            self._failures.append(reason)
            return False
        self.confirming = tuple(e for e in self._found if agree(old, e, alignment, self._config))
        self._found.append(alignment)
        return len(self.confirming) + 1 >= self._config.confirmations

    def verdict(self) -> tuple[str, str]:
        """(stage, reason) of a failure to meet."""
        if self._found:
            return "sim3", "alignments_do_not_agree" if len(self._found) > 1 else "alignment_not_confirmed"
        if "sim3" in self._failures:
            return "sim3", "too_few_inliers"
        return "overlap", "too_few_common_points" if self._failures else "old_map_not_reached"
