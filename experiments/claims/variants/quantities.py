"""What is known of a run of a variant: quantities of its row, by which variants are compared."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

FLOOR_M = 1e-4
"""Least error of which the logarithm is taken: below it is rounding."""


@dataclass(frozen=True)
class Quantity:
    """A quantity of a row.

    Attributes:
        label: what it is, with its unit.
        column: of the row.
        is_share: an event, 0 or 1, or a share.
        is_log: its natural logarithm is compared: a difference is that of a ratio.
        more_is_better: else less is.
    """

    label: str
    column: str
    is_share: bool = False
    is_log: bool = False
    more_is_better: bool = False

    def of(self, table: pd.DataFrame) -> pd.Series:
        """(N,) float values of the rows of a table, NaN where there is none."""
        known = np.array([np.nan if pd.isna(value) else float(value) for value in table[self.column]])
        values = np.log(np.maximum(known, FLOOR_M)) if self.is_log else known
        return pd.Series(values, table.index)


QUANTITIES = {
    "failed": Quantity("broke and was not rescued", "failed", is_share=True),
    "broke": Quantity("broke", "broke", is_share=True),
    "rescued": Quantity("of broken ones rescued", "rescued", is_share=True, more_is_better=True),
    "wrong": Quantity("claimed what is false, or ended with a wrong map", "wrong", is_share=True),
    "path_share": Quantity(
        "share of the path in the largest map", "path_share", is_share=True, more_is_better=True
    ),
    "tracked_share": Quantity("share of frames tracked", "tracked_share", is_share=True, more_is_better=True),
    "log_ate": Quantity("ATE, m", "ate_m", is_log=True),
    "ate_share": Quantity("ATE over the path", "ate_share"),
    "first_map_frames": Quantity("frames to the first map", "first_map_frames"),
    "next_map_frames": Quantity("frames to a map after a breakage", "next_map_frames"),
    "to_repair_s": Quantity("from breakage to rescue, s", "to_repair_s"),
    "recovery_cpu_s": Quantity("CPU time of recovery, s", "recovery_cpu_s"),
    "buffer_mb": Quantity("largest buffer, MB", "buffer_mb"),
    "cpu_ms": Quantity("CPU time a frame, ms", "cpu_ms"),
}
