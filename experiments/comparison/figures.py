"""Figures of runs, by sequence and system, with intervals over the runs."""

from dataclasses import asdict
from typing import Any

import numpy as np

from dslab.experiments.comparison.dose_groups import dose_groups
from dslab.experiments.comparison.identity import by_input, by_system
from dslab.experiments.comparison.left_runs import LeftRun
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit_text import runs_text
from dslab.experiments.evaluation.robustness import LEAST, MOST, robustness, share_within, step_errors
from dslab.experiments.statistics.spreads import Bounds, spread_of

FIGURES = {
    "robustness": "robustness",
    "completeness": "completeness",
    "path_share": "share of the path",
    "ate_m": "ATE, m",
    "rpe_m": "RPE, m per s",
    "breakages": "breakages",
    "cpu_ms_median": "CPU, ms per frame",
}
"""Figures of a system and their labels."""
THRESHOLDS = np.geomspace(LEAST / 3, MOST * 3, 61)
BOUNDS: dict[str, Bounds] = {
    name: "share" if name in ("robustness", "completeness", "path_share") else "amount" for name in FIGURES
}
"""What each figure is of."""
WRITTEN = BOUNDS | {"robustness": "amount"}
"""As what each is written: shares in percent, but for robustness, which is no part of something."""


def comparison_content(runs: list[LeftRun]) -> dict[str, Any]:
    """Everything that table and page show.

    Returns:
        Per input its name, true path and systems; per system its figures with their ``Spread`` over its runs,
        what the audit found, the path, errors and stages of the run with the median robustness, and the share
        of the path within each of ``thresholds``, the mean over the runs. Inputs
        that differ in a dose only are in ``dose_series`` too.

    Raises:
        InputError: a run does not say what it was given.
    """
    sequences, inputs = [], by_input(runs)
    for name, own in inputs.items():
        first = own[0]
        sequences.append(
            {
                "name": name,
                "true_path_m": metrics.path_length_m(first.T_world_cam),
                "truth": first.T_world_cam[:, :3, 3],
                "systems": [_system(system, of) for system, of in by_system(own).items()],
            }
        )
    return {"sequences": sequences, "dose_series": dose_groups(inputs), "thresholds": THRESHOLDS}


def _system(name: str, runs: list[LeftRun]) -> dict[str, Any]:
    values: list[dict[str, float | None]] = [_figures(run) for run in runs]
    scores = [own["robustness"] if own["robustness"] is not None else -1.0 for own in values]
    shown = runs[int(np.argsort(scores, kind="stable")[(len(scores) - 1) // 2])]
    within = [share_within(*step_errors(run.pairs, run.T_world_cam), THRESHOLDS) for run in runs]
    return {
        "name": name,
        "runs": len(runs),
        "audit": runs_text([run.summary for run in runs]),
        "figures": {
            figure: asdict(spread_of([own[figure] for own in values], BOUNDS[figure])) for figure in FIGURES
        },
        "within": np.mean(within, axis=0),
        "stages": _stages_ms(shown.summary),
        **_path(shown),
    }


def _stages_ms(summary: dict[str, Any]) -> dict[str, float]:
    """CPU time of each stage, shared out to all frames: few frames start a map."""
    frames = max(1, summary.get("frames", 1))
    known = {k: t for k, t in summary["stages"].items() if t.get("cpu_ms_median") is not None}
    return {stage: times["cpu_ms_median"] * times["frames"] / frames for stage, times in known.items()}


def _figures(run: LeftRun) -> dict[str, float | None]:
    summary = run.summary
    says = summary.get("declares", "breakages") != "nothing"
    return {
        "robustness": robustness(run.pairs, run.T_world_cam),
        "completeness": summary.get("completeness"),
        "path_share": summary.get("path_share"),
        "ate_m": summary.get("ate_m"),
        "rpe_m": summary.get("rpe_m"),
        "breakages": summary.get("breakages") if says else None,
        "cpu_ms_median": summary.get("cpu_ms_median"),
    }


def _path(run: LeftRun) -> dict[str, Any]:
    """Aligned positions and errors of all frames with truth, NaN without a pose."""
    positions, errors_m = np.full((len(run.stamps_s), 3), np.nan), np.full(len(run.stamps_s), np.nan)
    found = metrics.ate(run.pairs) if len(run.pairs) else Undefined("no pose")
    if not isinstance(found, Undefined):
        positions[run.pairs.frames] = found.alignment.points(run.pairs.T_map_cam[:, :3, 3])
        errors_m[run.pairs.frames] = found.errors_m
    time_s = run.stamps_s - run.stamps_s[0]
    return {"folder": str(run.folder), "time_s": time_s, "positions": positions, "errors_m": errors_m}
