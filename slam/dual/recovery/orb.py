"""Recovery thread 1: ORB tracking with a motion model, backward. Source: paper, Algorithm 1, lines 3-13."""

from dslab.slam.core.timing import StageTimer
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.propagation import propagate
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.tracking.tracker import Tracker


class OrbRecovery:
    """The base system's tracking and mapping, run backward."""

    name = "orb"
    needs_images = False
    # One core, 640x480, 1,000 features; rounded from 0.9, 15 and 4.7 measured, to agree with whole runs.
    cost = RecoveryCost(frame_ms=2.0, keyframe_ms=20.0, alignment_ms=4.0)

    def __init__(self, config: RecoveryConfig | None = None) -> None:
        self.config = config or RecoveryConfig()

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Track the buffered frames newest first, with a motion model."""
        tracker = Tracker(task.new_map, self.config.tracking_in(task), StageTimer(), task.motion)
        tracker.start(task.first, task.first.reference_keyframe, task.step)
        mapper = LocalMapper(task.new_map, self.config.mapping_in(task))
        return propagate(task, self.config, tracker, mapper)
