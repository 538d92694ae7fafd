"""Accuracy of a system beside a peer's over many sequences, each on the frames that both have placed."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.benchmarks.kept_rows import keep_rows
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.jobs.ledger import Row
from dslab.experiments.runs import execution
from dslab.experiments.runs.execution import RunRecord, SystemFactory, SystemKind, execute
from dslab.experiments.runs.sources import open_sequence
from dslab.experiments.runs.systems.registry import System
from dslab.experiments.runs.systems.run import ended_well, run_system
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder
from dslab.sim.sequence import Sequence as Frames
from dslab.slam.core.results import MapTrajectory

KEY = ("source", "seed", "system", "run")
OURS = "ours"
PEER = "peer"


def measure_accuracy(
    sources: Sequence[str],
    seeds: Sequence[int],
    system: SystemKind,
    folder: Path,
    peer: System | None = None,
    peer_runs: int = 3,
    skip_frames: int = 20,
    progress: Callable[[str, int, int], None] | None = None,
    build: SystemFactory | None = None,
) -> pd.DataFrame:
    """Run a system and a peer over the same frames; one row per run, kept in a folder.

    Ours runs once per sequence, in lockstep; a peer that differs from run to run, several times. Sequences
    that the folder has already are not run again.

    Args:
        sources: scenarios or folders, with ground truth.
        seeds: of each source and of the system. Of a folder, seed 1 + k leaves out the first k times
            ``skip_frames`` frames, so that it starts elsewhere.
        system: ours.
        folder: see :func:`experiments.benchmarks.kept_rows.keep_rows`.
        peer: any other system; None for none.
        peer_runs: runs of the peer per sequence.
        skip_frames: see ``seeds``.
        progress: called with (step, sequences done, sequences in all).
        build: makes the system, for tests; None for the real one.

    Returns:
        Per run ``frames``, ``tracked`` (with a live pose), ``posed`` (in the main map's final trajectory),
        ``ate_m``, ``first_over_last`` (scale, see :func:`experiments.evaluation.metrics.scale_along`),
        ``cpu_ms_median`` (tracking, per frame), ``cpu_s`` (in all; a peer's with its start and the reading of
        images); of a peer's run also, on the frames placed by both, ``common_poses``, ``common_ate_m`` and
        ``ours_common_ate_m``.

    Raises:
        InputError: a source cannot be read or has no ground truth, the peer fails, the folder is of
            something else or other code.
    """

    def run_sequence(job: tuple[str, int]) -> list[Row]:
        source, seed = job
        frames = _opened(source, seed, skip_frames)
        found = _run_both(frames, seed, system, peer, peer_runs, build)
        return [{"source": source, "seed": seed, **row} for row in found]

    wanted = [(source, seed) for seed in seeds for source in sources]
    return keep_rows(folder, "accuracy", KEY, {job: job for job in wanted}, run_sequence, None, progress)


def sums(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per source, from the rows of :func:`measure_accuracy`.

    Returns:
        ``sequences``; medians over them of ``ours_ate_m`` and, with a peer, of ``peer_ate_m``, both on common
        frames where there is a peer, each sequence's by the median of its peer's runs; ``ratio`` and
        ``worst_ratio``, median and largest of their ratios; ``ours_scale_off``, ``peer_scale_off``: distance
        of ``first_over_last`` from 1; ``cpu_ratio``, of tracking per frame; ``ours_posed``, ``peer_posed``:
        share of the frames.
    """
    found = []
    for source, own in rows.groupby("source", sort=False):
        each = pd.DataFrame([_of_sequence(of_seed) for _, of_seed in own.groupby("seed")])
        worst = each.pop("ratio")
        medians = each.median(skipna=True).to_dict()
        ratios = {"ratio": worst.median(), "worst_ratio": worst.max()}
        found.append({"source": source, "sequences": len(each), **medians, **ratios})
    return pd.DataFrame(found)


def _of_sequence(rows: pd.DataFrame) -> Row:
    """Figures of one sequence from its runs; NaN where there is none."""
    ours, peer = rows[rows.system == OURS], rows[rows.system == PEER]
    common = peer[["ours_common_ate_m", "common_ate_m"]].median() if len(peer) else None
    ours_ate_m = ours.ate_m.median() if common is None else common.ours_common_ate_m
    peer_ate_m = np.nan if common is None else common.common_ate_m
    return {
        "ours_ate_m": ours_ate_m,
        "peer_ate_m": peer_ate_m,
        "ratio": ours_ate_m / peer_ate_m,
        "ours_scale_off": abs(ours.first_over_last.median() - 1),
        "peer_scale_off": abs(peer.first_over_last.median() - 1),
        "cpu_ratio": ours.cpu_ms_median.median() / peer.cpu_ms_median.median(),
        "ours_posed": (ours.posed / ours.frames).median(),
        "peer_posed": (peer.posed / peer.frames).median(),
    }


def _opened(source: str, seed: int, skip_frames: int) -> Frames:
    frames = open_sequence(source, seed)
    if frames.T_world_cam is None:
        raise InputError(source, "has no ground truth", "name a sequence or scenario with ground truth")
    skipped = (seed - 1) * skip_frames if is_folder(Path(source)) else 0
    if skipped >= len(frames):
        problem = f"leaves out {skipped} of {len(frames)} frames"
        raise InputError(f"--seeds {seed}: {source}", problem, "give fewer seeds, or a smaller --skip-frames")
    return frames.only(np.arange(skipped, len(frames))) if skipped else frames


def _run_both(
    frames: Frames,
    seed: int,
    system: SystemKind,
    peer: System | None,
    runs: int,
    build: SystemFactory | None,
) -> list[Row]:
    record = execute(frames, system, seed, build=build or execution.system_factory("lockstep"))
    path = record.trajectories[0] if record.trajectories else None
    ours = _pairs(path, frames)
    rows: list[Row] = [{"system": OURS, "run": 0, **_own_figures(record), **_figures(ours, len(frames))}]
    for run in range(runs) if peer is not None else ():
        result = ended_well(run_system(peer, frames, seed))
        theirs = _pairs(result.trajectories[0] if result.trajectories else None, frames)
        figures = {**_own_figures(result), **_figures(theirs, len(frames)), **_on_common_frames(ours, theirs)}
        rows.append({"system": PEER, "run": run, **figures})
    return rows


def _own_figures(record: RunRecord) -> Row:
    each_ms = [sum(r.cpu_ms.values()) for r in record.results if r.cpu_ms]
    beside_ms = sum(r.mapping_cpu_ms + r.loop_cpu_ms for r in record.results)
    return {
        "tracked": sum(is_tracked(r) for r in record.results),
        "cpu_ms_median": float(np.median(each_ms)) if each_ms else None,
        "cpu_s": (sum(each_ms) + beside_ms) / 1000 if record.cpu_s is None else record.cpu_s,
    }


def _pairs(path: MapTrajectory | None, frames: Frames) -> PosePairs:
    truth = frames.T_world_cam
    if path is None:
        return PosePairs(np.zeros(0, int), np.zeros((0, 4, 4)), np.zeros((0, 4, 4)))
    return metrics.associate(path, frames.stamps_s, truth)


def _figures(pairs: PosePairs, frames: int) -> Row:
    scale = metrics.scale_along(pairs) if len(pairs) else Undefined("no pose")
    return {
        "frames": frames,
        "posed": len(pairs),
        "ate_m": _ate_m(pairs),
        "first_over_last": None if isinstance(scale, Undefined) else scale.first_over_last,
    }


def _on_common_frames(ours: PosePairs, theirs: PosePairs) -> Row:
    common = np.intersect1d(ours.frames, theirs.frames)
    return {
        "common_poses": len(common),
        "common_ate_m": _ate_m(theirs.where(np.isin(theirs.frames, common))),
        "ours_common_ate_m": _ate_m(ours.where(np.isin(ours.frames, common))),
    }


def _ate_m(pairs: PosePairs) -> float | None:
    found = metrics.ate(pairs) if len(pairs) else Undefined("no pose")
    return None if isinstance(found, Undefined) else found.rmse_m
