"""The Python interface: a sequence through a system, several of them in a table, an experiment."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from dslab.experiments.kernels import compile_kernels
from dslab.experiments.plugins import load_plugins
from dslab.experiments.runs.defaults import MODE, SYSTEM
from dslab.experiments.runs.execution import Mode, RunRecord, SystemFactory, system_factory
from dslab.experiments.runs.systems.registry import OwnSystem, Registry
from dslab.experiments.runs.systems.run import run_system
from dslab.scenarios.errors import InputError
from dslab.scenarios.spec import Scenario
from dslab.sim.sequence import Sequence
from dslab.slam.config import SlamConfig
from dslab.slam.core.events import Event
from dslab.slam.core.results import MapTrajectory
from dslab.slam.dual.config import DualConfig
from dslab.slam.factory import SYSTEMS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dslab.experiments.campaign.runner import Tally
    from dslab.experiments.eq1.spec import ExperimentSpec

_COLUMNS = (
    "completeness", "share_tracked", "path_share", "ate_m", "rpe_m", "breakages", "recoveries",
    "relocalizations", "maps", "cpu_ms_median",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """A finished run of one system over one sequence; ``record`` is everything that was kept of it."""

    record: RunRecord

    @property
    def sequence(self) -> Sequence:
        """The frames that the system was fed, with their truth."""
        return self.record.sequence

    @property
    def system(self) -> str:
        """Name of the system."""
        return self.record.system_kind

    @property
    def trajectory(self) -> MapTrajectory | None:
        """Final path of the map with most frames, camera to map; None without a map."""
        return next(iter(self.record.trajectories), None)

    @property
    def trajectories(self) -> tuple[MapTrajectory, ...]:
        """Final paths of all maps, the one with most frames first."""
        return self.record.trajectories

    @property
    def events(self) -> tuple[Event, ...]:
        """Everything that the system declared, in order; see ``slam.events``."""
        return self.record.events

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """The figures of ``summary.json``; those that the data do not determine are None."""
        from dslab.experiments.evaluation.summary import summarise

        return summarise(self.record)

    def plot(self, path: str | Path | None = None) -> "Figure":
        """Draw sample frames, the path over the truth and inliers over time; ``path`` is of a PNG file."""
        from dslab.experiments.pictures.run_picture import runs_figure

        figure = runs_figure({self.system: self.record})
        if path is not None:
            figure.savefig(path)
        return figure

    def save(self, folder: str | Path) -> Path:
        """Write the result folder, whole or not at all: trajectories, frames, events, summary, picture.

        Raises:
            InputError: the folder is taken or not writable.
        """
        from dslab.experiments.result_folder import write_run
        from dslab.sim.io.folders import new_directory

        with new_directory(Path(folder)) as unfinished:
            write_run(unfinished, self.record, self.metrics)
        return Path(folder)


def run(
    sequence: Sequence | Scenario | str | Path,
    system: str | SystemFactory = SYSTEM,
    *,
    seed: int | None = None,
    config: SlamConfig | None = None,
    dual: DualConfig | None = None,
    mode: Mode = MODE,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """Run a system over a sequence: image, time and intrinsics in, nothing else.

    Defaults are those of ``dslab run``.

    Args:
        sequence: a sequence, a scenario to render, or what names one: a folder, a scenario's name or file.
        system: name of a system of ``dslab systems list``, ``module:Class``, or a function of (name, camera,
            seed) that makes a system.
        seed: root of every random stream of the system, and of a scenario given by name; None for the
            scenario's own, or 0.
        config: settings of the base; by default the published ones for the image size.
        dual: settings of Dual-SLAM.
        mode: ``lockstep`` repeats bit for bit, ``threaded`` maps beside tracking.
        progress: called with (frames done, frames in all).

    Raises:
        InputError: the system is unknown, or the sequence is not valid.
    """
    load_plugins()
    compile_kernels()
    plugin = Registry.open().find(system) if isinstance(system, str) and system not in SYSTEMS else None
    sequence = sequence if isinstance(sequence, Sequence) else _opened(sequence, seed)
    seed = int(sequence.meta.get("seed", 0)) if seed is None else seed
    if plugin is not None:
        return Run(run_system(plugin, sequence, seed, progress=progress))
    build = system_factory(mode, dual, config) if isinstance(system, str) else system
    name = system if isinstance(system, str) else getattr(system, "__name__", "own")
    return Run(run_system(OwnSystem(name), sequence, seed, build, progress=progress))


def run_many(
    runs: Iterable[Mapping[str, Any]],
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Run]:
    """Run many runs side by side, each as ``run`` would; their figures are computed there too.

    Args:
        runs: the arguments of each by name, such as ``{"sequence": "breakage", "seed": 3}``. They go to
            another process: a sequence is named, or a scenario; a system is named.
        workers: processes; the runs are the same for any number. They start anew, so a script needs
            ``if __name__ == "__main__":`` and its extensions must be plugins.
        progress: called with (runs done, runs in all).

    Returns:
        The runs in the order given. Their frames are opened again where they are asked for.

    Raises:
        InputError: as ``run``, or a sequence is given as frames in memory; the other runs are lost.
        MachineError: a process has died.
    """
    from dslab.experiments.jobs.pool import run_each

    given = [dict(one) for one in runs]
    for index, one in enumerate(given):
        if isinstance(one.get("sequence"), Sequence):
            problem = "its sequence is frames in memory, which other processes do not share"
            raise InputError(f"runs[{index}]", problem, "name its folder or scenario, or give the scenario")
    compile_kernels()
    done: dict[int, Run] = {}
    for (index, _), finished in run_each(_run_one, list(enumerate(given)), workers):
        done[index] = finished
        if progress is not None:
            progress(len(done), len(given))
    return [done[index] for index in range(len(given))]


def _run_one(item: tuple[int, dict[str, Any]]) -> Run:
    """A run without its frames, but with all that is made of it."""
    arguments = item[1]
    finished = run(**arguments)
    kept = finished.sequence
    frames = _Reopened(arguments["sequence"], arguments.get("seed"), kept.stamps_s)
    light = Run(replace(finished.record, sequence=replace(kept, frames=frames, depths=None)))
    light.__dict__["metrics"] = finished.metrics
    return light


@dataclass(frozen=True)
class _Reopened:
    """The frames of some stamps, from the sequence that is opened when the first is asked for."""

    source: Scenario | str | Path
    seed: int | None
    stamps_s: np.ndarray

    def __len__(self) -> int:
        return len(self.stamps_s)

    def __getitem__(self, index: int) -> np.ndarray:
        at = np.searchsorted(self._whole.stamps_s, self.stamps_s[index])
        return self._whole.frames[int(at)]

    @cached_property
    def _whole(self) -> Sequence:
        return _opened(self.source, self.seed)


def _opened(sequence: Scenario | str | Path, seed: int | None) -> Sequence:
    from dslab.experiments.runs.sources import open_sequence
    from dslab.sim.sequence_rendering import render_sequence

    return render_sequence(sequence) if isinstance(sequence, Scenario) else open_sequence(str(sequence), seed)


def compare(runs: Iterable[Run]) -> pd.DataFrame:
    """Tabulate finished runs: one row each, by sequence and system.

    Accuracy is to be read beside completeness: a system that is lost early has little left to be wrong about.
    """
    keys = ["sequence", "system", "seed"]
    rows = [
        {"sequence": run.metrics["sequence"], "system": run.system, "seed": run.record.seed}
        | {name: run.metrics[name] for name in _COLUMNS}
        for run in runs
    ]
    return pd.DataFrame(rows, columns=[*keys, *_COLUMNS]).set_index(keys).astype({"ate_m": np.float64})


def run_experiment(
    experiment: "str | Path | ExperimentSpec",
    folder: str | Path,
    *,
    workers: int = 1,
    progress: "Callable[[Tally], None] | None" = None,
) -> "Tally":
    """Run an experiment on Eq. 1, or go on with it; then ``read_experiment`` and ``write_report``.

    Args:
        experiment: a spec, the name of a preset, or the path of a YAML file.
        folder: of its ledger, absent or that of an earlier run of the same spec.
        workers: processes; the rows are the same for any number. They start anew, so a script needs
            ``if __name__ == "__main__":`` and its extensions must be plugins.
        progress: called as each unit ends.

    Raises:
        InputError: the spec is not valid, a system is unknown or cannot run so, or the folder holds something
            else.
    """
    from dslab.experiments.campaign.runner import run_experiment as run_units
    from dslab.experiments.campaign.workers import unit_workers
    from dslab.experiments.eq1.spec import load_spec

    load_plugins()
    compile_kernels()
    spec = load_spec(experiment) if isinstance(experiment, str | Path) else experiment
    units = unit_workers(spec, workers=workers)
    return run_units(spec, Path(folder), units.open, show=progress, digests=units.digests)
