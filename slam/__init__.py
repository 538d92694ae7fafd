"""Monocular SLAM: images in, poses and events out. It knows no truth and no simulator.

The names below are what this package promises; everything else may change at any time. They are imported
when first used: ``import slam`` compiles nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dslab.slam.config import SlamConfig, default_config
    from dslab.slam.core import events
    from dslab.slam.core.camera import PinholeCamera
    from dslab.slam.core.events import TrackingState
    from dslab.slam.core.results import MapTrajectory, TrackingResult
    from dslab.slam.dual.config import DualConfig
    from dslab.slam.dual.dual_slam import DualSlam
    from dslab.slam.dual.recovery.interface import (
        RecoveryConfig,
        RecoveryCost,
        RecoveryResult,
        RecoveryTask,
        RecoveryThread,
    )
    from dslab.slam.dual.recovery.orb import OrbRecovery
    from dslab.slam.dual.recovery.registry import ThreadSpec, register_recovery_thread
    from dslab.slam.factory import SYSTEMS, build_system
    from dslab.slam.runtime.backend import ExecutionMode
    from dslab.slam.system import MonocularSlam, MonocularSystem
    from dslab.slam.warmup import warm_up

_HOMES = {
    "SYSTEMS": "dslab.slam.factory",
    "DualConfig": "dslab.slam.dual.config",
    "DualSlam": "dslab.slam.dual.dual_slam",
    "ExecutionMode": "dslab.slam.runtime.backend",
    "MapTrajectory": "dslab.slam.core.results",
    "MonocularSlam": "dslab.slam.system",
    "OrbRecovery": "dslab.slam.dual.recovery.orb",
    "PinholeCamera": "dslab.slam.core.camera",
    "RecoveryConfig": "dslab.slam.dual.recovery.interface",
    "RecoveryCost": "dslab.slam.dual.recovery.interface",
    "RecoveryResult": "dslab.slam.dual.recovery.interface",
    "RecoveryTask": "dslab.slam.dual.recovery.interface",
    "RecoveryThread": "dslab.slam.dual.recovery.interface",
    "SlamConfig": "dslab.slam.config",
    "MonocularSystem": "dslab.slam.system",
    "ThreadSpec": "dslab.slam.dual.recovery.registry",
    "TrackingResult": "dslab.slam.core.results",
    "TrackingState": "dslab.slam.core.events",
    "build_system": "dslab.slam.factory",
    "default_config": "dslab.slam.config",
    "events": "dslab.slam.core",
    "register_recovery_thread": "dslab.slam.dual.recovery.registry",
    "warm_up": "dslab.slam.warmup",
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
    return import_module("dslab.slam.core.events") if name == "events" else getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)
