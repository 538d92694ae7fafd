"""A recovery thread of your own: the ORB thread with all the patience in the world."""

import math

from dslab import experiments, scenarios, sim, slam


class PatientOrb:
    """The ORB thread, but it passes over any number of frames that it cannot use."""

    name = "patient_orb"
    needs_images = False
    cost = slam.RecoveryCost(frame_ms=2.0, keyframe_ms=20.0, alignment_ms=4.0)

    def __init__(self, config: slam.RecoveryConfig | None = None) -> None:
        self.config = config or slam.RecoveryConfig(max_unusable_s=math.inf)

    def run(self, task: slam.RecoveryTask) -> slam.RecoveryResult:
        """Go back over the buffer until the maps overlap or the frames are used up."""
        return slam.OrbRecovery(self.config).run(task)


slam.register_recovery_thread("patient_orb", PatientOrb)

if __name__ == "__main__":
    sequence = sim.render(scenarios.load("breakage", seed=1))
    for kinds in (("orb",), ("patient_orb",)):
        dual = slam.DualConfig(recovery_threads=tuple(map(slam.ThreadSpec, kinds)), relocalization=False)
        for event in experiments.run(sequence, "dual", dual=dual).events:
            if isinstance(event, slam.events.RecoveryEnd):
                said = "maps related" if event.success else f"{event.stage}: {event.reason}"
                print(f"{event.method}: {said} after {event.frames_covered} frames")
