"""Breakages of a run in words: when, and what became of each."""

from dataclasses import dataclass

from experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from experiments.runs.execution import RunRecord
from slam.core.events import Relocalized


@dataclass(frozen=True)
class Story:
    """A breakage and its end.

    Attributes:
        number: from 1, in the order of declaration.
        frame: of the declaration.
        end: frame from which the broken map is in use again; None if it never is.
        how: "relocalized", "fused" or "fused by place"; empty without an end.
        text: the whole in a few words, with times from the first frame on.
    """

    number: int
    frame: int
    end: int | None
    how: str
    text: str

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
