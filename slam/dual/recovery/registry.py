"""Recovery threads by name: a new kind is a file of its own and a line here."""

from collections.abc import Callable
from dataclasses import dataclass

from slam.dual.recovery.gms import GmsRecovery
from slam.dual.recovery.interface import RecoveryConfig, RecoveryThread
from slam.dual.recovery.orb import OrbRecovery
from slam.dual.recovery.sift import SiftRecovery

RECOVERY_KINDS: dict[str, Callable[[RecoveryConfig | None], RecoveryThread]] = {
    "orb": OrbRecovery,
    "sift": SiftRecovery,
    "gms": GmsRecovery,
}


@dataclass(frozen=True)
class ThreadSpec:
    """One recovery thread of a list.

    Attributes:
        kind: a key of ``RECOVERY_KINDS``.
        seed: of its random stream, beside that of the run.
        config: its settings, those of its kind by default.
    """

    kind: str
    seed: int = 0
    config: RecoveryConfig | None = None

    def __post_init__(self) -> None:
        """Check the kind."""
        if self.kind not in RECOVERY_KINDS:
            raise ValueError(f"unknown recovery thread {self.kind!r}: one of {', '.join(RECOVERY_KINDS)}")


def build_thread(spec: ThreadSpec) -> RecoveryThread:
    """The thread that a specification asks for."""
    return RECOVERY_KINDS[spec.kind](spec.config)


def parse_threads(text: str) -> tuple[ThreadSpec, ...]:
    """Threads from their kinds in order, such as ``"orb,sift"``; no text, no threads.

    A kind that comes again has a seed of its own.

    Raises:
        ValueError: naming the kinds that there are.
    """
    kinds = [name.strip() for name in text.split(",")] if text.strip() else []
    return tuple(ThreadSpec(kind, kinds[:i].count(kind)) for i, kind in enumerate(kinds))
