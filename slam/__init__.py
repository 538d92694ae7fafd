"""Monocular SLAM: images in, poses and events out. It knows no truth and no simulator.

The names below are what this package promises; everything else may change at any time. They are imported
when first used: ``import slam`` compiles nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slam.config import SlamConfig, default_config
    from slam.core import events
    from slam.core.camera import PinholeCamera
    from slam.core.events import TrackingState
    from slam.core.results import MapTrajectory, TrackingResult
    from slam.dual.config import DualConfig
    from slam.dual.dual_slam import DualSlam
    from slam.dual.recovery.interface import (
        RecoveryConfig,
        RecoveryCost,
        RecoveryResult,
        RecoveryTask,
        RecoveryThread,
    )
    from slam.dual.recovery.orb import OrbRecovery, OrbRecoveryConfig
    from slam.dual.recovery.registry import ThreadSpec, register_recovery_thread
    from slam.factory import SYSTEMS, build_system
    from slam.runtime.backend import ExecutionMode
    from slam.system import MonocularSlam, MonocularSystem
    from slam.warmup import warm_up

_HOMES = {
    "SYSTEMS": "slam.factory",
    "DualConfig": "slam.dual.config",
    "DualSlam": "slam.dual.dual_slam",
    "ExecutionMode": "slam.runtime.backend",
    "MapTrajectory": "slam.core.results",
    "MonocularSlam": "slam.system",
    "OrbRecovery": "slam.dual.recovery.orb",
    "OrbRecoveryConfig": "slam.dual.recovery.orb",
    "PinholeCamera": "slam.core.camera",
    "RecoveryConfig": "slam.dual.recovery.interface",
    "RecoveryCost": "slam.dual.recovery.interface",
    "RecoveryResult": "slam.dual.recovery.interface",
    "RecoveryTask": "slam.dual.recovery.interface",
    "RecoveryThread": "slam.dual.recovery.interface",
    "SlamConfig": "slam.config",
    "MonocularSystem": "slam.system",
    "ThreadSpec": "slam.dual.recovery.registry",
    "TrackingResult": "slam.core.results",
    "TrackingState": "slam.core.events",
    "build_system": "slam.factory",
    "default_config": "slam.config",
    "events": "slam.core",
    "register_recovery_thread": "slam.dual.recovery.registry",
    "warm_up": "slam.warmup",
}

__all__ = [
    "SYSTEMS",
    "DualConfig",
    "DualSlam",
    "ExecutionMode",
    "MapTrajectory",
    "MonocularSlam",
    "MonocularSystem",
    "OrbRecovery",
    "OrbRecoveryConfig",
    "PinholeCamera",
    "RecoveryConfig",
    "RecoveryCost",
    "RecoveryResult",
    "RecoveryTask",
    "RecoveryThread",
    "SlamConfig",
    "ThreadSpec",
    "TrackingResult",
    "TrackingState",
    "build_system",
    "default_config",
    "events",
    "register_recovery_thread",
    "warm_up",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(_HOMES[name])
    return import_module("slam.core.events") if name == "events" else getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)
