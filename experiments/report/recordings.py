"""Replayed failed units: their recordings, and their paths for a plot like Fig. 8."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.evaluation.scene import lay_out
from dslab.experiments.runs.execution import RunRecord
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.sim.cache import CorruptEntryError
from dslab.sim.io.folders import subfolder, write_file
from dslab.sim.io.raw import stored_archive

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec
    from dslab.experiments.eq1.units import UnitSpec

FOLDER = "recordings"
PATHS_FILE = "trajectories.npz"
WHICH = ("truth", "base", "dual")
_SHOWN = 9

Paths = dict[str, np.ndarray]


def add_recordings(
    report: dict[str, Any],
    spec: "ExperimentSpec",
    folder: Path,
    count: int,
    progress: Callable[[int, int], None],
) -> None:
    """Record the first failed units that have no recording, and store their paths.

    The failures of the report get the paths of their recordings, relative to the experiment's folder.
    """
    chosen = report["failures"][:count]
    subfolder(folder, FOLDER)
    for done, failure in enumerate(chosen):
        progress(done, len(chosen))
        failure["recording"] = f"{FOLDER}/{failure['unit_id']}.rrd"
        if not (folder / failure["recording"]).is_file():
            _record(spec.unit(failure["cell"], failure["index"]), failure["unit_id"], folder)
    progress(len(chosen), len(chosen))


def _record(unit: "UnitSpec", unit_id: str, folder: Path) -> None:
    from dslab.experiments.eq1.trial import record_unit

    def write(path: Path) -> None:
        add_paths(folder, unit_id, paths_of(record_unit(unit, path)))

    write_file(folder / FOLDER / f"{unit_id}.rrd", write)


def paths_of(runs: Sequence[RunRecord]) -> Paths:
    """True path, and paths of the largest maps of base and Dual-SLAM.

    Args:
        runs: runs of base and Dual-SLAM over one sequence with ground truth.

    Returns:
        By name in `WHICH`, (N, 3) float32 positions in the world in metres, one row per frame, NaN for none.
        Estimates are aligned to the truth for display; a system whose maps cannot be aligned is left out.
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
    """Store the paths of a unit in the folder's file, replacing earlier ones."""
    file = folder / PATHS_FILE
    arrays = {f"{unit_id}.{which}": path for which, path in paths.items()}
    if is_given(file):
        arrays = _arrays(file) | arrays
    write_file(file, lambda path: np.savez_compressed(path, **arrays))


def read_paths(folder: Path) -> dict[str, Paths]:
    """Paths of the first few replayed units by unit id.

    Raises:
        InputError: the folder's file holds something else or is damaged.
    """
    file = folder / PATHS_FILE
    if not is_given(file):
        return {}
    found: dict[str, Paths] = {}
    for name, path in _arrays(file).items():
        unit, _, which = name.rpartition(".")
        if which in WHICH:
            found.setdefault(unit, {})[which] = path
    return dict(list(found.items())[:_SHOWN])


def _arrays(file: Path) -> dict[str, np.ndarray]:
    """The paths in a file by name. Raises InputError if it holds anything else."""
    remedy = "delete it, the next report with recordings writes it anew"
    try:
        arrays = stored_archive(file)
    except CorruptEntryError as error:
        raise InputError(str(file), f"is no file of paths ({error})", remedy) from None
    for name, path in arrays.items():
        if path.ndim != 2 or path.shape[1] != 3 or path.dtype.kind != "f":
            raise InputError(f"{file}: {name}", "is no path of positions", remedy)
    return arrays
