"""Recovery threads by name."""

from collections.abc import Callable
from dataclasses import dataclass

from slam.dual.orb_thread import OrbRecovery
from slam.dual.recovery import RecoveryConfig, RecoveryThread

RECOVERY_KINDS: dict[str, Callable[[RecoveryConfig], RecoveryThread]] = {
    OrbRecovery.name: OrbRecovery,
}


@dataclass(frozen=True)
class ThreadSpec:
    """One recovery thread of a system.

    Attributes:
        kind: its name in ``RECOVERY_KINDS``.
        seed: of its random stream, beside the system's own.
        config: its settings.
    """

    kind: str
    seed: int = 0
    config: RecoveryConfig | None = None


def build_thread(spec: ThreadSpec) -> RecoveryThread:
    """The thread that a specification names.

    Raises:
        ValueError: there is no such kind.
    """
    if spec.kind not in RECOVERY_KINDS:
        raise ValueError(f"unknown recovery thread {spec.kind!r}: one of {', '.join(RECOVERY_KINDS)}")
    return RECOVERY_KINDS[spec.kind](spec.config or RecoveryConfig())


def parse_threads(text: str) -> tuple[ThreadSpec, ...]:
    """Threads from their kinds with commas between, such as ``orb,sift``.

    Raises:
        ValueError: a kind is unknown, or there is none.
    """
    specs = tuple(ThreadSpec(kind.strip()) for kind in text.split(","))
    for spec in specs:
        build_thread(spec)
    return specs
