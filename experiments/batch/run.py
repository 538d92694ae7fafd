"""Run a batch: every run is a job in a process of its own, whose row is kept when it ends."""

import os
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from shutil import rmtree

import numpy as np
import pandas as pd

from dslab.experiments.batch.breakages import add_overlaps
from dslab.experiments.batch.rows import CONTENT, DOSE, ERROR, KEY, Row, figures_of, typed
from dslab.experiments.batch.spec import BatchSpec
from dslab.experiments.evaluation.hypotheses import write_hypotheses
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.jobs.ledger import Owner, ledger_of
from dslab.experiments.jobs.pool import Ended, PoolSettings, open_pool
from dslab.experiments.result_folder import write_run
from dslab.experiments.runs.files import plain
from dslab.experiments.runs.identity import check_once, sequence_digest, system_identity
from dslab.experiments.runs.inputs import hashed
from dslab.experiments.runs.pacing import RealTime
from dslab.experiments.runs.provenance import code_hash, commit
from dslab.experiments.runs.sources import is_recorded, open_sequence
from dslab.experiments.runs.systems.registry import (
    Registry,
    System,
    check_startable,
    programs_of,
    system_digest,
    takes_real_time,
)
from dslab.experiments.runs.systems.run import run_system
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.scenarios.loading import load_scenario
from dslab.sim.degradations.recorded_sequences import degrade_sequence
from dslab.sim.io.folders import new_directory, write_file
from dslab.sim.sequence import Sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.belief.log import logged

ROWS_FILE, CSV_FILE, RUNS_DIR = "runs.parquet", "runs.csv", "runs"
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Job:
    """A run to be made.

    Attributes:
        spec: of the batch.
        system: as the spec names it.
        about: columns of its row that are known beforehand, of ``source``, ``run`` and ``seed`` among them.
        folders: of further descriptions of systems.
        folder: for its result.
        alone: it must not run beside others.
    """

    spec: BatchSpec
    system: str
    about: Row
    folders: tuple[Path, ...]
    folder: Path
    alone: bool

    @property
    def key(self) -> tuple:
        """What tells its row from the others."""
        return _key(self.about)

    @property
    def named(self) -> Row:
        """Its columns that follow the name of the sequence."""
        return {name: self.about[name] for name in ("source", "sequence")}

    @property
    def scene(self) -> tuple[str, int | None]:
        """Its source and the seed of a scenario; None for its own, and for what is recorded."""
        source = self.about["source"]
        drawn = self.spec.vary == "scenes" and not is_recorded(source)
        return source, int(self.about["seed"]) if drawn else None


def run_batch(
    spec: BatchSpec,
    sources: list[str],
    folder: Path,
    workers: int = 1,
    folders: Iterable[Path] = (),
    progress: Progress | None = None,
    task: Callable[[Job], Row] | None = None,
) -> pd.DataFrame:
    """Run what a folder does not have yet, and return every row of the batch.

    A row is kept as soon as its run has ended, so that a batch may be killed and started again. Runs that
    could not be made are made again then, and so are those of a system or a sequence that was changed.

    Args:
        spec: what to run.
        sources: its sequences, patterns written out.
        folder: of the results, absent or that of an earlier run with the same settings; more sequences,
            doses, systems and runs may be added.
        workers: runs at a time. Systems that take frames in real time run alone, after the others.
        folders: of further descriptions of systems.
        progress: called with (step, runs done, runs in all).
        task: makes a run in its process; :func:`make_run` by default.

    Raises:
        InputError: a system is unknown or cannot be started, a sequence cannot be read, two names stand for
            one sequence or system, or the folder holds something else or cannot be written.
    """
    folders, show = tuple(folders), progress or (lambda step, done, total: None)
    systems = {name: Registry.open(folders).find(name) for name in spec.systems}
    check_once("systems", {name: system_identity(system) for name, system in systems.items()})
    check_once("names of systems", {name: system.name for name, system in systems.items()})
    for system in systems.values():
        check_startable(system)
    contents: dict[str, str] = {}
    for source in sources:
        contents[source] = sequence_digest(source)
        show("reading", len(contents), len(sources))
    check_once("sequences", contents)
    settings = {
        "setting of stress, start, seed, mode or systems": spec.row_key,
        "version of the code": code_hash(),
    }
    with ledger_of(folder, Owner(settings, KEY)) as ledger:
        jobs = {job.key: job for job in _jobs(spec, contents, systems, folders, folder)}
        places = {_place(source): content for source, content in contents.items()}
        kept = ledger.rows()
        for row in kept:
            if outdated := places.get(_place(row["source"]), row[CONTENT]) != row[CONTENT]:
                rmtree(folder / row["folder"], ignore_errors=True)
            if outdated or not _stands(row, jobs):
                ledger.drop([row])
        done = {_key(row) for row in kept if _stands(row, jobs)}
        missing = [job for key, job in jobs.items() if key not in done]
        _render(missing, workers, show)
        made = len(jobs) - len(missing)
        for alone in (False, True):
            those = deque(job for job in missing if job.alone is alone)
            limits = PoolSettings(1 if alone else workers, None, spec.limit_s, None, True, False)
            with open_pool(task or make_run, limits) as pool:
                for ended in pool.run(those):
                    ledger.add(plain(_row(ended)))
                    made += 1
                    show("runs", made, len(jobs))
        rows = [row | jobs[_key(row)].named for row in ledger.rows() if _key(row) in jobs]
        found = typed(rows, [system.name for system in systems.values()])
    write_file(folder / ROWS_FILE, lambda path: found.to_parquet(path, index=False))
    write_file(folder / CSV_FILE, lambda path: found.to_csv(path, index=False))
    return found


def make_run(job: Job) -> Row:
    """Make a run, write its result folder, and return its row.

    Raises:
        InputError: the sequence cannot be read, or the system not be started.
    """
    spec = job.spec
    system = Registry.open(job.folders).find(job.system)
    # What a killed batch has left of this run.
    with suppress(OSError):
        rmtree(job.folder)
    with scratch_folder() as scratch, new_directory(job.folder) as folder:
        whole = _frames(job, scratch)
        first = int(job.about["first_frame"])
        frames = whole.only(np.arange(first, len(whole))) if first else whole
        pace = RealTime(frames) if spec.real_time else None
        with logged() if spec.hypotheses else nullcontext() as views:
            record = run_system(system, frames, job.about["seed"], spec.build, folder, pace=pace, whole=whole)
        summary = summarise(record)
        if not is_recorded(job.scene[0]):
            add_overlaps(record, summary["breakage_list"], load_scenario(*job.scene))
        write_run(folder, record, summary, picture=False)
        if views is not None:
            write_hypotheses(folder, views, Truth.of(record.sequence))
    return job.about | figures_of(record, summary)


def _frames(job: Job, scratch: Path) -> Sequence:
    """The first seconds of a sequence, with the stress, of which a run may leave out the first frames.

    The stress lies on the same frames in every run.
    """
    spec = job.spec
    sequence = open_sequence(*job.scene, first_s=spec.first_s)
    if spec.stress:
        segments = spec.segments(job.about[DOSE])
        sequence = degrade_sequence(sequence, segments, spec.seed, scratch, colour=False)  # type: ignore[arg-type]
    first = int(job.about["first_frame"])
    if first >= len(sequence):
        problem = f"run {job.about['run']} leaves out {first} of {len(sequence)} frames"
        raise InputError(job.about["source"], problem, "give fewer runs, or a smaller skip_frames")
    return hashed(sequence)


def _row(ended: Ended) -> Row:
    """The row of a run, however its process ended."""
    if ended.fault is not None:
        return ended.item.about | {"ended": ended.fault.value, "ended_message": ended.message}
    if ended.error is not None:  # the run could not be made, which the others need not suffer from
        return ended.item.about | {"ended": ERROR, "ended_message": ended.message}
    return ended.value


def _render(jobs: list[Job], workers: int, show: Progress) -> None:
    """Render every scenario once, for several runs at a time would each do so.

    What is wrong with one shows in its runs.
    """
    scenes = {job.scene: job for job in jobs if not is_recorded(job.about["source"])}
    limits = PoolSettings(workers, None, jobs[0].spec.limit_s if jobs else None, None, True, False)
    with open_pool(_render_one, limits) as pool:
        for number, _ in enumerate(pool.run(deque(scenes.values())), 1):
            show("rendering", number, len(scenes))


def _render_one(job: Job) -> None:
    open_sequence(*job.scene, first_s=job.spec.first_s)


def _stands(row: Row, jobs: dict[tuple, Job]) -> bool:
    """False for a row that is to be made again."""
    job = jobs.get(_key(row))
    return row["ended"] != ERROR and (job is None or job.about["system_digest"] == row["system_digest"])


def _key(row: Row) -> tuple:
    return tuple(row[name] for name in KEY)


def _place(source: str) -> str:
    """The one name of a folder or a file; a scenario's own."""
    return os.path.realpath(source) if is_given(source) else source


def _jobs(
    spec: BatchSpec,
    contents: dict[str, str],
    systems: dict[str, System],
    folders: tuple[Path, ...],
    folder: Path,
) -> list[Job]:
    """Every run, so that the first runs of all come first."""
    code, head, found = code_hash(), commit(), []
    digests = {name: system_digest(system) for name, system in systems.items()}
    for run in range(spec.runs):
        for (source, content), (dose, stress) in product(contents.items(), spec.stresses.items()):
            for named, system in systems.items():
                at = f"{spec.series.field}={dose!r}/" if spec.series else ""
                place = f"{RUNS_DIR}/{Path(source).name}-{content[:12]}/{at}{system.name}/{run:03d}"
                about: Row = {
                    "source": source,
                    "sequence": Path(source).name,
                    CONTENT: content,
                    "stress": "; ".join(stress),
                    DOSE: dose,
                    "system": system.name,
                    "run": run,
                    "seed": spec.seed + (run if spec.vary in ("seeds", "scenes") else 0),
                    "folder": place,
                    "first_frame": run * spec.skip_frames if spec.vary == "start" else 0,
                    "spec": spec.row_key,
                    "system_digest": digests[named],
                    "code": code,
                    "commit": head,
                }
                alone = takes_real_time(system) if programs_of(system) else spec.real_time
                found.append(Job(spec, named, about, folders, (folder / place).absolute(), alone))
    return found
