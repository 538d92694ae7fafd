"""Systems by name."""

from dataclasses import replace

from dslab.slam.config import SlamConfig, default_config
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.framework.odometry import Parts
from dslab.slam.ldso.config import DsoConfig
from dslab.slam.ldso.system import DsoSlam
from dslab.slam.orbslam import orbslam_config
from dslab.slam.runtime.backend import ExecutionMode
from dslab.slam.system import MonocularSlam, MonocularSystem

SYSTEMS = ("base", "dual", "dual+", "orbslam", "paper", "paper+", "dso", "ldso")
DIRECT = ("dso", "ldso")
ONE_MAP = ("base", "orbslam")
PAPERS = ("paper", "paper+")
DUAL = ("dual", "dual+", *PAPERS)
OwnSystem = MonocularSystem | DsoSlam


def parts_of(kind: str) -> Parts:
    """Which parts of the protocol of :mod:`slam.framework` a system has."""
    return Parts(losses=True, returns=kind not in DIRECT, points=True, exposures=kind in DIRECT)


def default_settings(kind: str, camera: PinholeCamera) -> tuple[SlamConfig, DualConfig]:
    """Settings of the base and of Dual-SLAM that a system has by itself, for the size of its images."""
    if kind in PAPERS:
        from dslab.slam.dual.paper import PAPER, paper_config

        return paper_config(camera, plus=kind == "paper+"), PAPER
    if kind == "orbslam":
        return orbslam_config(camera), DualConfig()
    return default_config(camera), DualConfig()


def build_system(
    kind: str,
    camera: PinholeCamera,
    seed: int = 0,
    config: SlamConfig | None = None,
    mode: ExecutionMode = ExecutionMode.LOCKSTEP,
    dual: DualConfig | None = None,
    dso: DsoConfig | None = None,
) -> OwnSystem:
    """Build a system by name.

    Args:
        kind: ``base``, or ``orbslam``, ORB-SLAM as published; ``dual``, ``dual+``, which is Dual-SLAM with
            initialisation by GMS, or ``paper`` and ``paper+``: the same by the paper's text on ``orbslam``;
            or ``dso``, direct sparse odometry, and ``ldso``, the same with loops.
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings; None for those of the kind, as of :func:`default_settings`. ``dso`` and ``ldso``
            take from it what concerns the first map from two views and loops.
        dual: likewise; only Dual-SLAM reads them.
        dso: likewise; only ``dso`` and ``ldso`` read them.
        mode: how tracking, mapping and loop closing share time; ``dso`` and ``ldso`` do all in turn.

    Raises:
        ValueError: on an unknown kind.
    """
    if kind not in SYSTEMS:
        raise ValueError(f"unknown system {kind!r}: one of {', '.join(SYSTEMS)}")
    defaults = default_settings(kind, camera)
    config, dual = config or defaults[0], dual or defaults[1]
    if kind in ONE_MAP:
        return MonocularSlam(camera, seed, config, mode)
    if kind in DIRECT:
        return DsoSlam(camera, seed, config, dso, loops=kind == "ldso")
    if kind == "dual+":
        config = replace(config, initialization=replace(config.initialization, matcher="gms"))
    return DualSlam(camera, seed, config, dual, mode)
