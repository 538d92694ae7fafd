"""Paths of units that were run again, kept in the experiment's folder for the overlays of Fig. 8."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.evaluation.scene import lay_out
from experiments.runs.execution import RunRecord
from sim.io.folders import write_file

PATHS_FILE = "trajectories.npz"
WHICH = ("truth", "base", "dual")
_SHOWN = 9

Paths = dict[str, np.ndarray]


def paths_of(runs: Sequence[RunRecord]) -> Paths:
    """The true path and, of base and Dual-SLAM, the path of the map with most frames.

    Args:
        runs: of base and Dual-SLAM over one sequence with truth.

    Returns:
        Per name of `WHICH` (N, 3) float32, one row per frame: positions in the world in metres, NaN where
        there is none. Estimates are aligned to the truth for the eye; a system whose maps are like the truth
        at no scale is left out.
    """
    truth = runs[0].sequence.T_world_cam
    if truth is None:
        return {}
    paths = {"truth": truth[:, :3, 3].astype(np.float32)}
    for which, run in zip(WHICH[1:], runs, strict=True):
        final = lay_out(run).final.values()
        if final:
            largest = max(final, key=lambda trajectory: len(trajectory.frames))
            paths[which] = np.full((len(truth), 3), np.nan, np.float32)
            paths[which][largest.frames] = largest.T_map_cam[:, :3, 3]
    return paths


def add_paths(folder: Path, unit_id: str, paths: Paths) -> None:
    """Put a unit's paths into the folder's file, in the place of earlier ones."""
    file = folder / PATHS_FILE
    arrays = {f"{unit_id}.{which}": path for which, path in paths.items()}
    if file.is_file():
        with np.load(file, allow_pickle=False) as earlier:
            arrays = {name: earlier[name] for name in earlier.files} | arrays
    write_file(file, lambda path: np.savez_compressed(path, **arrays))


def read_paths(folder: Path) -> dict[str, Paths]:
    """Paths per unit id, of the first few; empty where no unit was run again."""
    file = folder / PATHS_FILE
    if not file.is_file():
        return {}
    found: dict[str, Paths] = {}
    with np.load(file, allow_pickle=False) as arrays:
        for name in arrays.files:
            unit, _, which = name.rpartition(".")
            if which in WHICH:
                found.setdefault(unit, {})[which] = arrays[name]
    return dict(list(found.items())[:_SHOWN])
