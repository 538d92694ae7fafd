"""Systems by name."""

from dataclasses import replace

from slam.config import SlamConfig, default_config
from slam.core.camera import PinholeCamera
from slam.dual.config import DualConfig
from slam.dual.dual_slam import DualSlam
from slam.runtime.backend import ExecutionMode
from slam.system import MonocularSlam, MonocularSystem

SYSTEMS = ("base", "dual", "dual+")


def build_system(
    kind: str,
    camera: PinholeCamera,
    seed: int = 0,
    config: SlamConfig | None = None,
    mode: ExecutionMode = ExecutionMode.LOCKSTEP,
    dual: DualConfig | None = None,
) -> MonocularSystem:
    """Build a system by name.

    Args:
        kind: ``base``, ``dual``, or ``dual+``, which is Dual-SLAM with initialisation by GMS.
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings; None for the published ones for the image size.
        mode: how tracking, mapping and loop closing share time.
        dual: settings of Dual-SLAM; ignored by ``base``.

    Raises:
        ValueError: on an unknown kind.
    """
    if kind not in SYSTEMS:
        raise ValueError(f"unknown system {kind!r}: one of {', '.join(SYSTEMS)}")
    config = config or default_config(camera)
    if kind == "base":
        return MonocularSlam(camera, seed, config, mode)
    if kind == "dual+":
        config = replace(config, initialization=replace(config.initialization, matcher="gms"))
    return DualSlam(camera, seed, config, dual, mode)
