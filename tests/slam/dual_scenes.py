"""Whole runs of Dual-SLAM on toy sequences, for the tests of it."""

from dataclasses import replace
from unittest.mock import patch

from slam_scenes import blanked, feed, toy

from slam.config import default_config
from slam.core.results import MapTrajectory
from slam.dual.config import DualConfig
from slam.dual.dual_slam import DualSlam
from slam.dual.recovery.interface import RecoveryConfig, RecoveryCost
from slam.dual.recovery.orb import OrbRecovery
from slam.dual.recovery.registry import RECOVERY_KINDS, ThreadSpec
from slam.map.invariants import check_map
from slam.optimization.sim3 import horn_sim3
from slam.runtime.backend import ExecutionMode
from slam.warmup import CAMERA

STEP_M = 0.05
# A breakage that is mended, as events.
MENDED = ["breakage", "map_saved", "reinit_start", "initialized", "reinit_done", "recovery_start"]
MENDED += ["recovery_end", "fusion"]
# The sequences are short: a map of a second and a half is worth keeping.
CONFIG = replace(default_config(CAMERA), min_map_keyframes=3)


# Most of what is tested is recovery: in a scene that is still in view, place
# recognition would be there first.
RECOVERY_ONLY = DualConfig(threads=(ThreadSpec("orb"),), relocalization=False, place_merging=None)


def dual(config=RECOVERY_ONLY, mode=ExecutionMode.LOCKSTEP):
    """A system for the toy sequences."""
    return DualSlam(CAMERA, 0, CONFIG, config, mode)


def play(count, *spans):
    """A toy sequence with blank spans: the system, its answers, the truth."""
    images, stamps_s, T_world_cam = toy(count, 0, STEP_M)
    system = dual()
    return system, feed(system, blanked(images, *spans), stamps_s), T_world_cam


def of(system, kind):
    """A system's events of one kind."""
    return [e for e in system.events if e.kind == kind]


def scale_between(path: MapTrajectory, T_world_cam, first, last):
    """Metres per map unit over a stretch of frames."""
    here = (path.frames >= first) & (path.frames <= last)
    assert here.sum() > 20
    truth = T_world_cam[path.frames[here], :3, 3]
    return horn_sim3(truth, path.T_map_cam[here, :3, 3])[0]


def with_threads(count, spans, threads, check=True, **config):
    """A run over a toy sequence with blank spans, with recovery threads of the test's own.

    Args:
        count: frames.
        spans: of frames that are blank.
        threads: recovery threads, in their order.
        check: prove the maps in the end.
        config: of Dual-SLAM.
    """
    images, stamps_s, _ = toy(count, 0, STEP_M)
    system = with_own_threads(threads, **config)
    feed(system, blanked(images, *spans), stamps_s, check=False)
    for map_id in system.maps() if check else ():
        check_map(system.map(map_id))
    return system


def with_own_threads(threads, mode=ExecutionMode.LOCKSTEP, seeds=(), **config):
    """A system whose recovery threads are the test's own, registered for it."""
    own = {f"own {i}": lambda _, t=thread: t for i, thread in enumerate(threads)}
    with patch.dict(RECOVERY_KINDS, own):
        specs = tuple(map(ThreadSpec, own, seeds or [0] * len(threads)))
        return dual(replace(RECOVERY_ONLY, threads=specs, **config), mode)


class Slow(OrbRecovery):
    """The recovery thread, said to take some seconds per buffered frame."""

    def __init__(self, frame_s, config=None):
        super().__init__(config or RecoveryConfig())
        self.cost = RecoveryCost(1e3 * frame_s, 0.0, 0.0)
