"""Systems by name."""

from slam.backend import ExecutionMode
from slam.camera import PinholeCamera
from slam.config import SlamConfig, default_config
from slam.dual.supervisor import DualSlam
from slam.system import MonocularSlam


def build_system(
    kind: str,
    camera: PinholeCamera,
    seed: int = 0,
    config: SlamConfig | None = None,
    mode: ExecutionMode = ExecutionMode.LOCKSTEP,
) -> MonocularSlam:
    """A system by name.

    Args:
        kind: ``base`` or ``dual``.
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings; the published defaults, scaled to the image size, where None.
        mode: how tracking, mapping and loop closing share time.

    Raises:
        ValueError: on an unknown kind.
    """
    systems = {"base": MonocularSlam, "dual": DualSlam}
    if kind not in systems:
        raise ValueError(f"unknown system {kind!r}: one of {', '.join(systems)}")
    return systems[kind](camera, seed, config or default_config(camera), mode=mode)
