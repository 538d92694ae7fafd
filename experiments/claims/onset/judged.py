"""Units of an onset experiment with their verdicts: since when wrong, what came before the loss, placebo."""

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.claims.onset.rule import Onset, StepBounds, causes, onset, unusual_bounds
from dslab.experiments.claims.onset.unit import BROKE, HELD, STEP, UNIT, VOID, OnsetSpec, read_series
from dslab.experiments.eq1.records import SHAM
from dslab.scenarios.seeds import rng_for

if TYPE_CHECKING:
    import pandas as pd

WRONG, MOVED, UNUSUAL = LEVELS = "wrong", "moved", "unusual"
"""Beyond the bounds of the audit; likewise, whatever its new points; beyond a multiple of what other worlds
show without stress."""
RARE = 0.95
"""Rank among the frames of the lead-in from which an error is a rare one."""


class JudgedUnits:
    """The units of a table that are not void and whose stress acted, if they have one.

    Args:
        spec: of the experiment.
        table: all rows.

    Attributes:
        units: rows of them, each with ``place``, the world with its base: the sample.
    """

    def __init__(self, spec: OnsetSpec, table: "pd.DataFrame") -> None:
        self._spec = spec
        rows = table[(table.row_kind == UNIT) & (table.outcome != VOID) & (table.exposed != 0)]
        steps = table[table.row_kind == STEP]
        self._steps = {unit: own.to_dict("records") for unit, own in steps.groupby("unit")}
        self.units: list[dict[str, Any]] = [
            row | {"place": f"{row['base']} {row['world']}"} for row in rows.to_dict("records")
        ]
        self._calm = {_key(unit): unit for unit in self.units if unit["stress"] == SHAM}
        self._bounds = {key: self._bounds_of(key) for key in map(_key, self.units)}

    def table(self) -> "pd.DataFrame":
        """One row per unit.

        Returns:
            The columns of ``units``, and ``end_frame``: that of the declared loss, or the last; ``late_s``,
            how long before the declared loss was the true one; ``silent_s``, of a map that did not break: for
            how long it was wrong at the end, or the pose truly lost, as what bends a map once is right again
            over the widest baseline later. Per level, of ``LEVELS``: ``{level}_frame`` and
            ``{level}_cause``, see :class:`Onset`; ``{level}_s``, how long before the end, 0 for not; likewise
            ``{level}_true_s`` before the true loss, None without one; ``{level}_ever``, whether it was at any
            step; ``{level}_placebo_s``, how long the same world's unstressed map had been so at the same
            time, None where there is none. ``narrow_rank``: rank, among the frames of the lead-in, of the
            error in metres of the live pose relative to the last keyframe, median over the time just before
            the end; ``narrow_ratio``, over the lead-in's median; ``narrow_placebo_rank`` as above;
            ``onset_narrow_rank``: before the onset of wrongness instead of the end.
        """
        import pandas as pd

        return pd.DataFrame([unit | self._verdict(unit) for unit in self.units])

    def placebo(self, system: str, level: str) -> dict[str, list[float]]:
        """How long maps without stress had been wrong at random times, per place, by the same rule."""
        found = {}
        for (place, of_system), unit in self._calm.items():
            if of_system != system or level not in self._bounds[place, system]:
                continue
            rng = rng_for(self._spec.root_seed, "claim", "placebo", place)
            first, last = int(unit["stress_frame"]), int(unit["last_frame"])
            ends = rng.integers(first, last + 1, self._spec.placebo_times)
            found[place] = [self._since(unit, level, int(end))[1] for end in ends]
        return found

    def _verdict(self, unit: dict[str, Any]) -> dict[str, Any]:
        beside = self._calm.get(_key(unit)) if unit["stress"] != SHAM else None
        end = int(unit["declared_frame"] if unit["outcome"] == BROKE else unit["last_frame"])
        if beside is not None and beside["outcome"] == BROKE and beside["declared_frame"] <= end:
            beside = None
        lost = unit["true_loss_frame"]
        lost = int(lost) if lost is not None and np.isfinite(lost) else None
        stamps_s = read_series(unit, "stamps_s")
        late_s = None if lost is None or unit["outcome"] != BROKE else _between_s(stamps_s, lost, end)
        found: dict[str, Any] = {"end_frame": end, "late_s": late_s}
        for level in self._bounds[_key(unit)]:
            at_end, found[f"{level}_s"] = self._since(unit, level, end)
            found |= {f"{level}_frame": at_end.frame, f"{level}_cause": at_end.cause}
            found[f"{level}_true_s"] = None if lost is None else self._since(unit, level, lost)[1]
            bounds = self._bounds[_key(unit)][level]
            found[f"{level}_ever"] = any(causes(step, bounds) for step in self._steps.get(unit["unit"], []))
            found[f"{level}_placebo_s"] = beside and self._since(beside, level, end)[1]
        silent_s = [found[f"{WRONG}_s"], *([] if lost is None else [_between_s(stamps_s, lost, end)])]
        found["silent_s"] = max(silent_s) if unit["outcome"] == HELD else None
        found["narrow_rank"], found["narrow_ratio"] = self._narrow(unit, end)
        found["narrow_placebo_rank"] = beside and self._narrow(beside, end)[0]
        wrong = found[f"{WRONG}_frame"]
        found["onset_narrow_rank"] = None if wrong is None else self._narrow(unit, wrong)[0]
        return found

    def _bounds_of(self, key: tuple[str, str]) -> dict[str, StepBounds]:
        """The bounds of both levels for a place and system; without other worlds only those of the audit."""
        base = key[0].rpartition(" ")[0]
        others = [
            self._steps.get(unit["unit"], [])
            for (place, system), unit in self._calm.items()
            if place != key[0] and unit["base"] == base and system == key[1]
        ]
        unusual = unusual_bounds(others, self._spec.unusual)
        wrong = StepBounds()
        return {WRONG: wrong, MOVED: replace(wrong, points=inf)} | (
            {} if unusual is None else {UNUSUAL: unusual}
        )

    def _since(self, unit: dict[str, Any], level: str, end_frame: int) -> tuple[Onset, float]:
        """Onset of a unit at an end, and how long before."""
        found = onset(self._steps.get(unit["unit"], []), end_frame, self._bounds[_key(unit)][level])
        stamps_s = read_series(unit, "stamps_s")
        return found, 0.0 if found.frame is None else _between_s(stamps_s, found.frame, end_frame)

    def _narrow(self, unit: dict[str, Any], end_frame: int) -> tuple[float | None, float | None]:
        """Rank and ratio of the live pose's error just before an end, among those of the lead-in."""
        offset_m, stamps_s = read_series(unit, "offset_m"), read_series(unit, "stamps_s")
        frames = np.arange(len(offset_m))
        just = (frames < end_frame) & (stamps_s >= stamps_s[end_frame] - self._spec.just_before_s)
        before, usual = (offset_m[of & np.isfinite(offset_m)] for of in (just, frames < unit["stress_frame"]))
        if not len(before) or not len(usual):
            return None, None
        error_m, usual_m = float(np.median(before)), float(np.median(usual))
        return float((usual < error_m).mean()), error_m / usual_m if usual_m else None


def _key(unit: dict[str, Any]) -> tuple[str, str]:
    return unit["place"], unit["system"]


def _between_s(stamps_s: np.ndarray, first: int, last: int) -> float:
    """Time between two frames, to the digits of a stamp."""
    return round(float(stamps_s[last] - stamps_s[first]), 4)
