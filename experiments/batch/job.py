"""One run of a batch, made in a process of its own."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree

import numpy as np

from dslab.experiments.batch.rows import About, Row
from dslab.experiments.batch.spec import BatchSpec
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.plugins import load_plugins
from dslab.experiments.result_folder import execute_recorded, write_run
from dslab.experiments.runs.execution import system_factory
from dslab.experiments.runs.sources import open_sequence
from dslab.experiments.runs.systems.registry import Registry
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder
from dslab.sim.degradations.recorded_sequences import degrade_sequence
from dslab.sim.io.folders import new_directory
from dslab.sim.sequence import Sequence
from dslab.sim.unfinished import scratch_folder


@dataclass(frozen=True)
class Job:
    """A run to be made.

    Attributes:
        spec: of the batch.
        source, system, run: which run it is; the system as the spec names it.
        about: what its row says beforehand.
        folders: of further descriptions of systems.
        folder: for its result.
        alone: it must not run beside others.
    """

    spec: BatchSpec
    source: str
    system: str
    run: int
    about: About
    folders: tuple[Path, ...]
    folder: Path
    alone: bool

    @property
    def scene_seed(self) -> int | None:
        """Seed of a scenario; None for its own, and for a folder."""
        drawn = self.spec.vary == "scenes" and not is_folder(self.source)
        return int(self.about.columns["seed"]) if drawn else None


def run_job(job: Job) -> Row:
    """Make a run, write its result folder, and return its row.

    Raises:
        InputError: the sequence cannot be read, or the system not be started.
    """
    import cv2

    cv2.setNumThreads(1)
    load_plugins()
    spec = job.spec
    plugins = Registry.open(job.folders).find_all([job.system])
    (name,) = plugins
    # What a killed batch has left of this run.
    with suppress(OSError):
        rmtree(job.folder)
    with scratch_folder() as scratch, new_directory(job.folder) as folder:
        record = execute_recorded(
            sequence_of(job, scratch),
            [name],
            job.about.columns["seed"],
            build=system_factory(spec.mode),
            real_time=spec.real_time,
            plugins=plugins,
            folder_of=lambda _: folder,
        )[name]
        summary = summarise(record)
        write_run(folder, record, summary, picture=False)
    return job.about.row(record, summary)


def sequence_of(job: Job, scratch: Path) -> Sequence:
    """The frames of a run: the first seconds, with the stress, from where this run starts.

    The stress lies on the same frames in every run, whichever frames are left out before.

    Raises:
        InputError: it cannot be read, or no frames are left.
    """
    spec = job.spec
    sequence = open_sequence(job.source, job.scene_seed, first_s=spec.first_s)
    if spec.stress:
        sequence = degrade_sequence(sequence, spec.segments, spec.seed, scratch)  # type: ignore[arg-type]
    first = int(job.about.columns["first_frame"])
    if first >= len(sequence):
        problem = f"run {job.run} leaves out {first} of {len(sequence)} frames"
        raise InputError(job.source, problem, "give fewer runs, or a smaller skip_frames")
    return sequence.only(np.arange(first, len(sequence))) if first else sequence
