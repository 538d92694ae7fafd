"""Breakages of a run, and cuts on request, in words: when, and what became of each."""

from dataclasses import dataclass

from dslab.experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Fusion, MapCut, Relocalized

CUT = "cut"
"""Name of a cut on request."""
_DROPPED = "map dropped"


@dataclass(frozen=True)
class Story:
    """A breakage, or a cut, and its end.

    Attributes:
        name: what it is, numbered from 1 in the order of declaration.
        frame: of the declaration.
        end: frame from which the broken map is in use again, or tracking goes on without it; None for never.
        how: "relocalized", "fused", "fused by place", or "bridged", where a recovery went past it to an older
            map; "map dropped" where a map too young for a recovery made room for a new one; empty without an
            end.
    """

    name: str
    frame: int
    end: int | None
    how: str

    @property
    def is_repaired(self) -> bool:
        """True if what was tracked before it and after it lies in one map."""
        return self.how not in ("", _DROPPED)

    def label_at(self, frame: int) -> str:
        """A few words, as far as it is known at a frame."""
        is_over = self.end is not None and frame >= self.end
        return self.name + (f": {self.how}" if is_over else "")


def stories(record: RunRecord) -> list[Story]:
    """The stories of all breakages of a run, in order, then those of its cuts."""
    stamps_s = list(record.sequence.stamps_s)
    outcomes = breakage_outcomes(record.events, record.sequence.segments, stamps_s)
    broken = [_story(f"breakage {number}", outcome) for number, outcome in enumerate(outcomes, 1)]
    return [*broken, *(_cut(event, record) for event in record.events if isinstance(event, MapCut))]


def _cut(cut: MapCut, record: RunRecord) -> Story:
    fused = [e.frame for e in record.events if isinstance(e, Fusion) and e.accepted]
    end = min((frame for frame in fused if frame >= cut.frame), default=None)
    return Story(CUT, cut.frame, end, "" if end is None else "fused")


def _story(name: str, outcome: BreakageOutcome) -> Story:
    repairs = (outcome.fusion if outcome.recovered else None, outcome.relocalized, outcome.joined)
    frame, repair = outcome.breakage.frame, min(filter(None, repairs), key=lambda e: e.frame, default=None)
    if repair is None and outcome.bridged is not None:
        return Story(name, frame, outcome.bridged.frame, "bridged")
    if repair is None and outcome.dropped:
        return Story(name, frame, outcome.reinit_frame, _DROPPED if outcome.reinit_frame else "")
    if repair is None:
        return Story(name, frame, None, "")
    how = (
        "relocalized"
        if isinstance(repair, Relocalized)
        else "fused by place"
        if repair is outcome.joined
        else "fused"
    )
    return Story(name, frame, repair.frame, how)
