"""What an experiment is and takes, before it runs: folders under a place, and the expected time."""

import os
from collections.abc import Iterator, Mapping, Sequence
from math import sqrt
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.folder import SPEC_FILE, TABLE_FILE
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.units import RECOVERING, system_label
from dslab.experiments.jobs.ledger import LEDGER_FILE

DEPTH = 4
"""Folders within folders that are looked into."""
FRAME_S = {"base": 0.02, "dso": 0.14, "ldso": 0.14}
"""Worker time per frame of 320x240, with its rendering: of 210 frames 4.3 s of the base (docs/rescue), 28.9 s
of ldso (docs/ldso)."""
ONE_ARM_S, BOTH_ARMS_S = 0.05, 0.06
"""Likewise of systems with recovery threads: 10.4 s (docs/ldso) and 12.9 s (docs/eq1)."""
_PIXELS = 320 * 240


def experiments_under(place: Path) -> Iterator[Path]:
    """Folders of experiments, in the order of their names; hidden folders are left out."""
    for folder, inside, files in os.walk(place):
        if {LEDGER_FILE, TABLE_FILE} & set(files) and SPEC_FILE in files:
            yield Path(folder)
        depth = len(Path(folder).relative_to(place).parts)
        inside[:] = sorted(name for name in inside if not name.startswith(".")) if depth < DEPTH else []


def expected_worker_s(spec: ExperimentSpec, rows: Sequence[Mapping[str, Any]] = ()) -> float:
    """Worker time that the units of an experiment take, in seconds: its own units tell best.

    Where none of a system has ended, the time per frame is that of the published tables, on one core, with
    images of four times the pixels twice as long (docs/eq1-vga). Systems of other people count as ours.

    Args:
        spec: of the experiment.
        rows: records of its units so far.
    """
    scenario = spec.unit(spec.cell_names()[0], 0).scenario
    pixels = scenario.camera.width_px * scenario.camera.height_px
    frames = scenario.frame_count * sqrt(pixels / _PIXELS)
    total_s = 0.0
    for cell in spec.cells.values():
        name = system_label(cell.system)
        known = [row["wall_s"] for row in rows if row["system"] == name and row["wall_s"]]
        arms = len({"free", "crossing"} & set(spec.arms)) if cell.system in RECOVERING else 1
        frame_s = FRAME_S.get(name, BOTH_ARMS_S if arms == 2 else ONE_ARM_S)
        total_s += spec.units * (sum(known) / len(known) if known else frames * frame_s)
    return total_s
