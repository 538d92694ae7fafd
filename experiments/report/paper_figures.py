"""Figures of the paper, shown beside those of a report.

Source: Huang et al., "Dual-SLAM: A framework for robust single camera navigation", IROS 2020, Table I;
Tables II and III are in ``statistics.paper``.
"""

from dataclasses import dataclass
from typing import Any

from dslab.experiments.statistics.paper import TABLE_II, TABLE_III


@dataclass(frozen=True)
class PaperSequence:
    """Row of Table I: median RMSE in metres over ten trials, None without a map.

    Attributes:
        unstable: True if some trials of ORB-SLAM failed.
    """

    name: str
    orb_slam_m: float | None
    dual_m: float | None
    dual_plus_m: float | None
    ldso_m: float
    unstable: bool


TABLE_1 = tuple(
    PaperSequence(f"KITTI {name}", *figures)
    for name, *figures in (
        ("00", 8.18, 7.48, 7.30, 9.30, True),
        ("01", None, None, None, 10.31, True),
        ("02", 24.11, 24.74, 23.35, 25.73, True),
        ("03", 1.18, 1.29, 1.25, 2.14, False),
        ("04", 1.65, 1.39, 1.20, 0.79, False),
        ("05", 8.23, 8.23, 6.26, 5.43, False),
        ("06", 15.84, 17.86, 13.29, 12.57, False),
        ("07", 2.43, 2.50, 2.59, 1.54, False),
        ("08", 51.34, 50.23, 49.99, 115.90, True),
        ("09", 50.69, 13.72, 6.97, 70.59, True),
        ("10", 7.68, 7.68, 6.92, 14.79, False),
    )
)

TABLE_1_FAILED = {name: failed for name, (failed, _) in TABLE_II["KITTI"].items()} | {"LDSO": 0}
"""Failed trials of 110, by system."""

_TOTAL = {
    system: tuple(sum(row[system][i] for row in TABLE_II.values()) for i in range(2))
    for system in ("ORB-SLAM", "Dual-SLAM", "Dual-SLAM⁺")
}
PAPER: dict[str, Any] = {"table_1": TABLE_1, "table_2": TABLE_II | {"total": _TOTAL}, "table_3": TABLE_III}
