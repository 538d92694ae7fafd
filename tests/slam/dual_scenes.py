"""Runs of Dual-SLAM on toy sequences."""

from dataclasses import replace
from unittest.mock import patch

from slam_scenes import blanked, feed, toy

from dslab.slam.config import default_config
from dslab.slam.core.results import MapTrajectory
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS, ThreadSpec
from dslab.slam.map.invariants import check_map
from dslab.slam.optimization.sim3 import horn_sim3
from dslab.slam.runtime.backend import ExecutionMode
from dslab.slam.toy_sequence import CAMERA

STEP_M = 0.05
# The events of a breakage with a successful recovery.
RECOVERED = ["breakage", "map_saved", "reinit_start", "initialized", "reinit_done", "recovery_start"]
RECOVERED += ["recovery_end", "fusion"]
# The sequences are short: maps of 1.5 s are kept. Without noise, nothing would be lost with faint corners.
DEFAULT = default_config(CAMERA)
CONFIG = replace(DEFAULT, min_map_keyframes=3, orb=replace(DEFAULT.orb, faint_share=0.0))


# Most tests are about recovery: in a scene that is still in view, place recognition would act first.
RECOVERY_ONLY = DualConfig(recovery_threads=(ThreadSpec("orb"),), relocalization=False, place_merging=None)


def dual(config=RECOVERY_ONLY, mode=ExecutionMode.LOCKSTEP):
    """A system for the toy sequences."""
    return DualSlam(CAMERA, 0, CONFIG, config, mode)


def play(count, *spans):
    """A toy sequence with blank spans: the system, its results, the truth."""
    images, stamps_s, T_world_cam = toy(count, 0, STEP_M)
    system = dual()
    return system, feed(system, blanked(images, *spans), stamps_s), T_world_cam


def of(system, kind):
    """A system's events of one kind."""
    return [e for e in system.events if e.kind == kind]


def scale_between(path: MapTrajectory, T_world_cam, first, last):
    """Metres per map unit over a range of frames."""
    here = (path.frames >= first) & (path.frames <= last)
    assert here.sum() > 20
    truth = T_world_cam[path.frames[here], :3, 3]
    return horn_sim3(truth, path.T_map_cam[here, :3, 3])[0]


def with_threads(count, spans, threads, check=True, **config):
    """A run over a toy sequence with blank spans, with given recovery threads.

    Args:
        count: number of frames.
        spans: ranges of blank frames.
        threads: recovery threads, in their order.
        check: check the maps at the end.
        config: settings of Dual-SLAM.
    """
    images, stamps_s, _ = toy(count, 0, STEP_M)
    system = with_own_threads(threads, **config)
    feed(system, blanked(images, *spans), stamps_s, check=False)
    for map_id in system.maps() if check else ():
        check_map(system.map(map_id))
    return system


def with_own_threads(threads, mode=ExecutionMode.LOCKSTEP, seeds=(), **config):
    """A system with given recovery threads, registered for it."""
    own = {f"own {i}": lambda _, t=thread: t for i, thread in enumerate(threads)}
    with patch.dict(RECOVERY_KINDS, own):
        specs = tuple(map(ThreadSpec, own, seeds or [0] * len(threads)))
        return dual(replace(RECOVERY_ONLY, recovery_threads=specs, **config), mode)


class Slow(OrbRecovery):
    """The ORB recovery thread with a declared cost in seconds per buffered frame."""

    def __init__(self, frame_s, config=None):
        super().__init__(config or RecoveryConfig())
        self.cost = RecoveryCost(1e3 * frame_s, 0.0, 0.0)
