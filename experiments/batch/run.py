"""Run a batch: every run in a process of its own, its row kept when it ends, real-time ones alone."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import pandas as pd

from dslab.experiments.batch.job import Job, run_job
from dslab.experiments.batch.rows import ERROR, KEY, About, Row, typed
from dslab.experiments.batch.spec import BatchSpec
from dslab.experiments.benchmarks.kept_rows import read_rows, write_rows
from dslab.experiments.campaign.folder_lock import sole_driver
from dslab.experiments.plugins import load_plugins
from dslab.experiments.runs.ending import EndKind
from dslab.experiments.runs.processes import call_in_process, side_by_side
from dslab.experiments.runs.provenance import code_hash, commit
from dslab.experiments.runs.sources import open_sequence
from dslab.experiments.runs.systems.command import CommandSystem
from dslab.experiments.runs.systems.registry import Registry, System, system_digest
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder
from dslab.sim.io.folders import unwritable, write_file

ROWS_FILE, CSV_FILE, RUNS_DIR = "runs.parquet", "runs.csv", "runs"
Progress = Callable[[str, int, int], None]
RunJob = Callable[[Job], Row]


def run_batch(
    spec: BatchSpec,
    sources: list[str],
    folder: Path,
    workers: int = 1,
    folders: Iterable[Path] = (),
    progress: Progress | None = None,
    task: RunJob = run_job,
) -> pd.DataFrame:
    """Run what a folder does not have yet, and return every row of the batch.

    A row is kept as soon as its run has ended, so that a batch may be killed and started again. Runs that
    could not be made are made again then, and so are those of a system that was changed.

    Args:
        spec: what to run.
        sources: its sequences, patterns written out.
        folder: of the results, absent or that of an earlier run with the same settings; more sequences,
            systems and runs may be added.
        workers: runs at a time. Systems that take frames in real time run alone, after the others.
        folders: of further descriptions of systems.
        progress: called with (step, runs done, runs in all).
        task: makes a run in its process; another one for tests.

    Raises:
        InputError: a system is unknown or cannot be started, or the folder holds something else or cannot be
            written.
    """
    folders = tuple(folders)
    systems = {name: Registry.open(folders).find(name) for name in spec.systems}
    for system in systems.values():
        if isinstance(system, CommandSystem):
            system.check()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    with sole_driver(folder):
        table = folder / ROWS_FILE
        rows = _kept(table, spec)
        jobs = _jobs(spec, sources, systems, folders, folder)
        digests = {
            (job.source, _name(systems, job), job.run): job.about.columns["system_digest"] for job in jobs
        }
        rows = [row for row in rows if _stands(row, digests)]
        done = {tuple(row[name] for name in KEY) for row in rows}
        missing = [job for job in jobs if (job.source, _name(systems, job), job.run) not in done]
        _render(missing, workers, progress)
        for number, row in enumerate(_made(missing, workers, task), len(jobs) - len(missing) + 1):
            rows.append(row)
            try:
                write_rows(table, typed(rows).to_dict("records"), KEY)
            except OSError as error:
                raise unwritable(table, error) from error
            if progress is not None:
                progress("runs", number, len(jobs))
        found = typed([row for row in rows if tuple(row[name] for name in KEY) in digests])
        write_file(folder / CSV_FILE, lambda path: found.to_csv(path, index=False))
    return found


def _render(jobs: list[Job], workers: int, progress: Progress | None) -> None:
    """Render every scenario once, for several runs at a time would each do so."""
    scenarios = sorted({(job.source, job.scene_seed) for job in jobs if not is_folder(job.source)}, key=str)
    calls = [(*scenario, jobs[0].spec.first_s, jobs[0].spec.limit_s) for scenario in scenarios]
    for number, _ in enumerate(side_by_side(workers, _rendered, calls), 1):
        if progress is not None:
            progress("rendering", number, len(scenarios))


def _rendered(source: str, seed: int | None, first_s: float | None, time_s: float) -> None:
    """Render a scenario into the cache; what is wrong with it shows in its runs."""
    with suppress(Exception):
        call_in_process(_render_one, (source, seed, first_s), time_s)


def _render_one(source: str, seed: int | None, first_s: float | None) -> None:
    load_plugins()
    open_sequence(source, seed, first_s=first_s)


def _name(systems: dict[str, System], job: Job) -> str:
    return systems[job.system].name


def _kept(table: Path, spec: BatchSpec) -> list[Row]:
    rows = [{k: v for k, v in row.items() if not pd.isna(v)} for row in read_rows(table, "runs", code_hash())]
    if any(row.get("spec") != spec.row_key for row in rows):
        problem = "has runs with other settings of stress, start, seed or mode"
        raise InputError(str(table.parent), problem, "choose another folder")
    return rows


def _stands(row: Row, digests: dict[tuple, str]) -> bool:
    """False for a row that is to be made again."""
    key = tuple(row[name] for name in KEY)
    return row["ended"] != ERROR and digests.get(key, row["system_digest"]) == row["system_digest"]


def _jobs(
    spec: BatchSpec, sources: list[str], systems: dict[str, System], folders: tuple[Path, ...], folder: Path
) -> list[Job]:
    """Every run, so that the first runs of all come first."""
    code, head, found = code_hash(), commit(), []
    digests = {name: system_digest(system) for name, system in systems.items()}
    for run in range(spec.runs):
        for number, source in enumerate(sources):
            for named, system in systems.items():
                place = f"{RUNS_DIR}/{number:03d}-{Path(source).name}/{system.name}/{run:03d}"
                about: Row = {
                    "source": source,
                    "sequence": Path(source).name,
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
                alone = _needs_quiet(system, spec)
                at = (folder / place).absolute()
                found.append(Job(spec, source, named, run, About(about), folders, at, alone))
    return found


def _needs_quiet(system: System, spec: BatchSpec) -> bool:
    if isinstance(system, CommandSystem):
        return system.takes_real_time
    return spec.real_time


def _made(jobs: list[Job], workers: int, task: RunJob) -> Iterator[Row]:
    """Make runs and yield each row as it ends: first those that may run side by side, then the others."""
    yield from side_by_side(workers, _row, [(job, task) for job in jobs if not job.alone])
    yield from side_by_side(1, _row, [(job, task) for job in jobs if job.alone])


def _row(job: Job, task: RunJob) -> Row:
    """The row of a run, however its process ends."""
    try:
        return call_in_process(task, (job,), job.spec.limit_s)
    except TimeoutError:
        return job.about.without_figures(EndKind.TIMED_OUT, f"not done after {job.spec.limit_s:g} s")
    except ChildProcessError as error:
        return job.about.without_figures(EndKind.CRASHED, str(error))
    except Exception as error:  # the run could not be made, which the others need not suffer from
        return job.about.without_figures(ERROR, " ".join(f"{type(error).__name__}: {error}".split()))
