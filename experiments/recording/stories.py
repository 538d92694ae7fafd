"""Breakages of a run in words: when, and what became of each."""

from dataclasses import dataclass

from dslab.experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Relocalized

_DROPPED = "map dropped"


@dataclass(frozen=True)
class Story:
    """A breakage and its end.

    Attributes:
        number: from 1, in the order of declaration.
        frame: of the declaration.
        end: frame from which the broken map is in use again, or tracking goes on without it; None for never.
        how: "relocalized", "fused", "fused by place", or "bridged", where a recovery went past it to an older
            map; "map dropped" where a map too young for a recovery made room for a new one; empty without an
            end.
        text: the whole in a few words, with times from the first frame on.
    """

    number: int
    frame: int
    end: int | None
    how: str
    text: str

    @property
    def is_repaired(self) -> bool:
        """True if what was tracked before it and after it lies in one map."""
        return self.how not in ("", _DROPPED)

    def text_at(self, frame: int) -> str:
        """Text as far as it is known at a frame."""
        return self.text if frame >= (self.end or 0) else self.text.partition(", ")[0]


def stories(record: RunRecord) -> list[Story]:
    """The stories of all breakages of a run, in order."""
    stamps_s = list(record.sequence.stamps_s)
    outcomes = breakage_outcomes(record.events, record.sequence.segments, stamps_s)
    return [_story(number, outcome, stamps_s) for number, outcome in enumerate(outcomes, 1)]


def _story(number: int, outcome: BreakageOutcome, stamps_s: list[float]) -> Story:
    def at(frame: int) -> str:
        return f"at {stamps_s[frame] - stamps_s[0]:.2f} s"

    repairs = (outcome.fusion if outcome.recovered else None, outcome.relocalized, outcome.joined)
    frame, repair = outcome.breakage.frame, min(filter(None, repairs), key=lambda e: e.frame, default=None)
    begun = f"breakage {number} {at(frame)}"
    if repair is None and outcome.bridged is not None:
        end = outcome.bridged.frame
        return Story(number, frame, end, "bridged", f"{begun}, bridged {at(end)}")
    if repair is None and outcome.dropped:
        end = outcome.reinit_frame
        return Story(number, frame, end, _DROPPED if end else "", f"{begun}, {_DROPPED}")
    if repair is None:
        return Story(number, frame, None, "", f"{begun}, not repaired")
    how = (
        "relocalized"
        if isinstance(repair, Relocalized)
        else "fused by place"
        if repair is outcome.joined
        else "fused"
    )
    return Story(number, frame, repair.frame, how, f"{begun}, {how} {at(repair.frame)}")
