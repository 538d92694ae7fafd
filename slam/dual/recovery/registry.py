"""Recovery threads by name; a kind is imported when it is built, as specs need the names only."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from pydantic_core import core_schema

if TYPE_CHECKING:
    from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryThread

RecoveryFactory = Callable[["RecoveryConfig | None"], "RecoveryThread"]
"""Makes a thread from its settings; from None with its defaults."""


def _orb(config: "RecoveryConfig | None") -> "RecoveryThread":
    from dslab.slam.dual.recovery.orb import OrbRecovery

    return OrbRecovery(config)


def _sift(config: "RecoveryConfig | None") -> "RecoveryThread":
    from dslab.slam.dual.recovery.sift import SiftRecovery

    return SiftRecovery(config)


def _gms(config: "RecoveryConfig | None") -> "RecoveryThread":
    from dslab.slam.dual.recovery.gms import GmsRecovery

    return GmsRecovery(config)


def _direct(config: "RecoveryConfig | None") -> "RecoveryThread":
    from dslab.slam.dual.recovery.direct import DirectRecovery

    return DirectRecovery(config)


def _paper_orb(config: "RecoveryConfig | None") -> "RecoveryThread":
    from dslab.slam.dual.recovery.paper import paper_orb_config

    return _orb(config or paper_orb_config())


def _paper_sift(config: "RecoveryConfig | None") -> "RecoveryThread":
    from dslab.slam.dual.recovery.paper import paper_sift_config

    return _sift(config or paper_sift_config())


RECOVERY_KINDS: dict[str, RecoveryFactory] = {
    "orb": _orb,
    "sift": _sift,
    "gms": _gms,
    "direct": _direct,
    "paper_orb": _paper_orb,
    "paper_sift": _paper_sift,
}
"""Factories by kind; :func:`register_recovery_thread` adds one."""


def register_recovery_thread(kind: str, factory: RecoveryFactory) -> None:
    """Add a kind of recovery thread, to be named in ``ThreadSpec`` and ``dslab run --recovery``.

    Args:
        kind: its name, in small letters, digits and underscores.
        factory: makes a thread from its settings, or with its defaults from None. It is called with a
            subclass of ``RecoveryConfig`` where settings are given.

    Raises:
        ValueError: the name is no name, or taken.
    """
    if not (kind.isidentifier() and kind.islower()):
        raise ValueError(f"{kind!r} is no name for a recovery thread: use small letters, digits and _")
    if RECOVERY_KINDS.get(kind, factory) is not factory:
        raise ValueError(f"there is a recovery thread {kind!r} already: name yours differently")
    RECOVERY_KINDS[kind] = factory


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
    config: "RecoveryConfig | None" = None

    def __post_init__(self) -> None:
        """Check the kind."""
        if self.kind not in RECOVERY_KINDS:
            raise ValueError(f"unknown recovery thread {self.kind!r}: one of {', '.join(RECOVERY_KINDS)}")

    @classmethod
    def __get_pydantic_core_schema__(cls, *_: Any) -> core_schema.CoreSchema:
        """As a field of settings it is taken as it is."""
        return core_schema.no_info_plain_validator_function(
            cls._taken, json_schema_input_schema=core_schema.any_schema()
        )

    @classmethod
    def _taken(cls, value: object) -> Self:
        if not isinstance(value, cls):
            raise ValueError(f"must be ThreadSpec, as of parse_threads('orb,sift'), is {value!r}")
        return value


def build_thread(spec: ThreadSpec) -> "RecoveryThread":
    """Build the thread of a specification."""
    return RECOVERY_KINDS[spec.kind](spec.config)


def parse_threads(text: str) -> tuple[ThreadSpec, ...]:
    """Parse threads from their kinds in order, such as ``"orb,sift"``; no text, no threads.

    A kind that comes again has a seed of its own.

    Raises:
        ValueError: naming the kinds that there are.
    """
    kinds = [name.strip() for name in text.split(",")] if text.strip() else []
    return tuple(ThreadSpec(kind, kinds[:i].count(kind)) for i, kind in enumerate(kinds))
