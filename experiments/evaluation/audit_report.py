"""The audit of a whole run: true losses, declared or silent, its final maps, and all that was declared."""

from dataclasses import asdict, dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit import BOUNDS, AuditBounds, LossAudit, audit_loss
from dslab.experiments.evaluation.breakages import (
    EXPOSURE_GRACE_S,
    BreakageOutcome,
    breakage_outcomes,
    segment_of_frame,
)
from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.relation_audit import RELATION_BOUNDS
from dslab.experiments.evaluation.truth_convention import truth_fault
from dslab.experiments.evaluation.whole_run_audit import LiveAudit, WrongStretch, audit_live, audit_maps
from dslab.experiments.runs.execution import RunRecord

_LOOKBACK_S = 2.0
"""Time before a breakage outside every segment in which the loss may have started."""


@dataclass(frozen=True)
class LossFinding:
    """True loss in one window of frames.

    Attributes:
        segment: index of the injected segment, None outside every segment.
        onset_frame, end_frame: the window, inclusive; of a silent loss elsewhere the wrong poses.
        declared_frame: frame of the breakage; None if none was declared.
        true_loss_frame: see LossAudit; None also if it could not be judged.
        delay_s: from the true loss to the declaration; None unless both are known.
        silent: truly lost and never declared; None if it could not be judged.
        reason: reason why it could not be judged; empty otherwise.
    """

    segment: int | None
    onset_frame: int
    end_frame: int
    declared_frame: int | None
    true_loss_frame: int | None
    delay_s: float | None
    silent: bool | None
    reason: str


def loss_findings(
    record: RunRecord, outcomes: list[BreakageOutcome], live: LiveAudit, bounds: AuditBounds
) -> list[LossFinding]:
    """Audit true loss in every injected segment, at every other breakage, and where nothing was declared."""
    stamps_s, segments = record.sequence.stamps_s, record.sequence.segments
    findings, seen = [], set()
    for index, segment in enumerate(segments):
        if segment.first_frame < 0:
            continue
        declared = next((o.breakage.frame for o in outcomes if index in o.segments), None)
        last = np.searchsorted(stamps_s, stamps_s[segment.last_frame] + EXPOSURE_GRACE_S, side="right") - 1
        end = int(last) if declared is None else declared
        findings.append(_finding(record, bounds, index, segment.first_frame, end, declared))
        seen.add(declared)
    late = {s.declared_frame: s for s in live.wrong if s.declared_frame is not None}
    for outcome in outcomes:
        frame = outcome.breakage.frame
        if frame in late and frame not in seen:
            findings.append(_stretch(late[frame], outcome.segment, stamps_s))
        elif frame not in seen:
            onset = int(np.searchsorted(stamps_s, stamps_s[frame] - _LOOKBACK_S))
            findings.append(_finding(record, bounds, outcome.segment, onset, frame, frame))
    known = [f for f in findings if f.true_loss_frame is not None]
    for stretch in live.wrong:
        if stretch.declared_frame is None and not any(_same(stretch, f) for f in known):
            first = stretch.first_frame
            segment = segment_of_frame(first, stamps_s[first], segments, stamps_s.tolist())
            findings.append(_stretch(stretch, segment, stamps_s))
    return findings


def audit_loss_in(
    record: RunRecord, onset_frame: int, end_frame: int, bounds: AuditBounds = BOUNDS
) -> LossAudit | Undefined:
    """`audit_loss` of the map in which the frame before the onset was tracked; Undefined also if none was.

    The record is of a run over a sequence with truth.
    """
    before = record.results[onset_frame - 1] if onset_frame > 0 else None
    if before is None or before.T_map_cam is None:
        return Undefined("not tracking at the onset")
    truth = Truth.of(record.sequence)
    return audit_loss(record.live[before.map_id], truth, onset_frame, end_frame, bounds)


def declaration_delay_s(stamps_s: np.ndarray, lost: int | None, declared: int | None) -> float | None:
    """Time from the true loss to the declaration, given their frames; None unless both exist."""
    return None if lost is None or declared is None else float(stamps_s[declared] - stamps_s[lost])


def audit_record(record: RunRecord) -> dict | None:
    """The audit as part of the summary; None without truth."""
    if record.sequence.T_world_cam is None:
        return None
    stamps_s = record.sequence.stamps_s
    outcomes = breakage_outcomes(record.events, record.sequence.segments, stamps_s.tolist())
    live = audit_live(record, BOUNDS)
    losses = loss_findings(record, outcomes, live, BOUNDS)
    path = record.trajectories[0] if record.trajectories else None
    return {
        "truth_fault": truth_fault(Truth.of(record.sequence), path) if path else "",
        "bounds": asdict(BOUNDS),
        "relation_bounds": asdict(RELATION_BOUNDS),
        "losses": [asdict(f) | {"true_loss_time_s": _time_s(f.true_loss_frame, stamps_s)} for f in losses],
        "live": {name: value for name, value in vars(live).items() if name != "wrong"},
        "maps": [
            found | {"time_s": _time_s(found["first_frame"], stamps_s)}
            for found in audit_maps(record, BOUNDS)
        ],
        **audit_declared(record).rows(float(stamps_s[0])),
    }


def _finding(
    record: RunRecord,
    bounds: AuditBounds,
    segment: int | None,
    onset: int,
    end: int,
    declared: int | None,
) -> LossFinding:
    audit = audit_loss_in(record, onset, end, bounds)
    if isinstance(audit, Undefined):
        return LossFinding(segment, onset, end, declared, None, None, None, audit.reason)
    loss = audit.true_loss_frame
    delay_s = declaration_delay_s(record.sequence.stamps_s, loss, declared)
    return LossFinding(
        segment, onset, end, declared, loss, delay_s, loss is not None and declared is None, ""
    )


def _stretch(stretch: WrongStretch, segment: int | None, stamps_s: np.ndarray) -> LossFinding:
    """The finding of wrong live poses, declared in the end or silent."""
    first, declared = stretch.first_frame, stretch.declared_frame
    end = stretch.last_frame if declared is None else declared
    delay_s = declaration_delay_s(stamps_s, first, declared)
    return LossFinding(segment, first, end, declared, first, delay_s, declared is None, "")


def _same(stretch: WrongStretch, finding: LossFinding) -> bool:
    """True if a stretch is the loss of a finding."""
    lost = finding.true_loss_frame
    return lost is not None and stretch.first_frame <= finding.end_frame and stretch.last_frame >= lost


def _time_s(frame: int | None, stamps_s: np.ndarray) -> float | None:
    """Time of a frame since the first."""
    return None if frame is None else float(stamps_s[frame] - stamps_s[0])
