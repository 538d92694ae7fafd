"""How a run of a system ended, and what a system declares: of ours and of other people's."""

from dataclasses import dataclass
from enum import StrEnum


class EndKind(StrEnum):
    """How a run ended. All but ``finished`` are outcomes of systems that are not ours."""

    FINISHED = "finished"
    CRASHED = "crashed"
    TIMED_OUT = "timed_out"
    OUT_OF_MEMORY = "out_of_memory"
    NOT_FINITE = "not_finite"
    UNREADABLE = "unreadable"
    OTHER_STAMPS = "other_stamps"


@dataclass(frozen=True)
class Ending:
    """How a run ended.

    Attributes:
        kind: the outcome.
        message: one line about it; empty if the run finished.
        remedy: what to do about it; empty if nothing is known.
        log: what is known beyond the line, such as a traceback.
    """

    kind: EndKind = EndKind.FINISHED
    message: str = ""
    remedy: str = ""
    log: str = ""

    @property
    def is_of_description(self) -> bool:
        """True if not the run went wrong, but what it left is not what was described."""
        return self.kind in (EndKind.UNREADABLE, EndKind.OTHER_STAMPS)


FINISHED = Ending()
"""The end of a run in which nothing went wrong."""


class Declares(StrEnum):
    """What a system says of itself; the rest is known from the frames without a pose, and from the audit."""

    EVENTS = "events"
    """Losses and all that becomes of them, as our systems do."""
    LOSSES = "losses"
    """Losses, in its own words, and not what becomes of them."""
    NOTHING = "nothing"
