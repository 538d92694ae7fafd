"""Breakages of a batch's runs: which maps were healthy, what rescued them, could images do so at all."""

from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.batch.rows import DOSE
from dslab.experiments.comparison.left_summary import read_summary
from dslab.experiments.evaluation.broken_maps import usable_frames
from dslab.experiments.evaluation.view_overlap import best_overlap, is_rescuable
from dslab.experiments.runs.execution import RunRecord
from dslab.scenarios.spec import Scenario
from dslab.slam.dual.config import DualConfig

BREAKAGES_FILE = "breakages.csv"


def add_overlaps(record: RunRecord, breakages: list[dict], scenario: Scenario) -> None:
    """Add ``view_overlap``, the largest of two usable frames on either side, by exact depth.

    Args:
        record: of the run.
        breakages: of its summary; those of a map of which too little is known are left out.
        scenario: that the sequence was rendered from.
    """
    buffer_s = record.config.get("dual", {}).get("buffer_s", DualConfig.buffer_s)
    truth = record.sequence.T_world_cam
    for row in breakages:
        if row["healthy"] is not None and truth is not None:
            usable = usable_frames(record.sequence, row["frame"], row["segment_index"], buffer_s)
            row["view_overlap"] = best_overlap(scenario, truth, *usable).overlap


def breakages(rows: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """Every breakage of a batch, as in the summary of its run.

    Args:
        rows: of :func:`experiments.batch.run.run_batch`.
        folder: of the batch.
    """
    found = []
    for own in rows[rows.breakages.fillna(0) > 0].to_dict("records"):
        summary = read_summary(folder / own["folder"])
        run = {name: own[name] for name in ("source", DOSE, "system", "run", "seed")}
        found += [run | {"breakage": k} | row for k, row in enumerate(summary["breakage_list"], start=1)]
    return pd.DataFrame(found)


def rescues(found: pd.DataFrame) -> pd.DataFrame:
    """Per source, dose, system and cause: breakages of healthy maps; of these recovered, and by each thread.

    With the median and the 95th percentile of the time from a recovery's start to its fusion, s. Where views
    on either side overlap too little for any recovery by images, ``views`` is ``hopeless``, else ``shared``;
    ``unknown`` without exact depth.

    Args:
        found: of :func:`breakages`.
    """
    if found.empty:
        return found
    threads = sorted(name for name in found.columns if name.removeprefix("thread_").isdigit())
    counted = ["recovered", *threads, "false_fusion"]
    healthy = found[found.healthy.eq(True)].assign(breakages=1)
    healthy[counted] = healthy[counted].eq(True)  # they may be missing
    healthy["to_fusion_s"] = healthy["to_fusion_s"].astype(float)
    healthy["cause"] = healthy["segment"].fillna("")
    overlap = healthy["view_overlap"] if "view_overlap" in healthy else [np.nan] * len(healthy)
    healthy["views"] = [
        "unknown" if pd.isna(share) else "shared" if is_rescuable(share) else "hopeless" for share in overlap
    ]
    groups = healthy.groupby(["source", DOSE, "system", "cause", "views"], dropna=False)
    sums, delay = groups[["breakages", *counted]].sum(), groups["to_fusion_s"]
    return sums.assign(to_fusion_s_median=delay.median(), to_fusion_s_p95=delay.quantile(0.95)).reset_index()
