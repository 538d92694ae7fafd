"""A pool of processes: one item at a time per worker, and every item ends, whatever becomes of its process.

No worker gets a second item before its first has ended, so a dead process has one cause. The pool itself
retries nothing: the caller decides on retries and counts them.
"""

import os
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection, get_context
from pathlib import Path
from typing import Any, Self

import psutil

from dslab.experiments.jobs.worker import Task, serve
from dslab.experiments.runs.ending import EndKind
from dslab.scenarios.errors import InputError, MachineError
from dslab.sim.unfinished import scratch_folder

MEMORY_FLOOR_MB = 400
"""Least memory limit of a worker: it takes 190 MB to start, 250 to 310 MB with all that a unit
imports."""
SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
LATE_S = 60.0
"""Time allowed beyond an item's limit; its process should have ended itself by then."""
_LOOK_S = 0.1
_TICK_S = 1.0
_REPORT_CHARACTERS = 16_000
_MIB = 2**20


@dataclass(frozen=True)
class PoolSettings:
    """Settings of a pool.

    Attributes:
        workers: number of processes on this machine.
        scheduler: address of a Dask scheduler whose workers are used instead, as ``tcp://10.0.0.1:8786``.
        time_s: longest duration of an item; None for no limit.
        memory_mb: resident memory at which a process of this machine is ended; None for no limit.
        fresh: give every item a process of its own.
        single_threaded: numerical libraries compute in one thread, as workers share the cores.

    Raises:
        InputError: no item could run within such a limit.
    """

    workers: int = 1
    scheduler: str | None = None
    time_s: float | None = None
    memory_mb: int | None = None
    fresh: bool = False
    single_threaded: bool = True

    def __post_init__(self) -> None:
        if self.memory_mb is not None and self.memory_mb < MEMORY_FLOOR_MB:
            raise InputError(
                "--memory",
                f"{self.memory_mb} MB is less than the {MEMORY_FLOOR_MB} MB that a worker takes to start",
                "give megabytes, for example 4000, or 0 for no limit",
            )
        if self.time_s is not None and not 0 < self.time_s <= threading.TIMEOUT_MAX:
            raise InputError("--timeout", f"{self.time_s:g} s is no time limit", "give seconds")


@dataclass(frozen=True)
class Ended:
    """An item that has ended.

    Attributes:
        item, worker: the item, and the name of its worker.
        value: result of the task; None if it raised or its process ended.
        error: what the task raised; None if it did not.
        fault: how its process ended; None if it did not.
        message, report: of error or fault: one line, and the stacks of the threads if known.
    """

    item: Any
    worker: str
    value: Any = None
    error: Exception | None = None
    fault: EndKind | None = None
    message: str = ""
    report: str = ""

    def result(self) -> Any:
        """Result of the task.

        Raises:
            MachineError: its process ended before.
            Exception: what the task raised.
        """
        if self.error is not None:
            raise self.error
        if self.fault is not None:
            raise MachineError("a worker process", self.message, "run the same command again")
        return self.value


class Pool(ABC):
    """Workers, each with one item or none."""

    @abstractmethod
    def free(self) -> list[str]:
        """Names of the workers without an item."""

    @abstractmethod
    def start(self, item: Any, worker: str) -> None:
        """Give an item to a free worker."""

    @abstractmethod
    def wait(self, timeout_s: float) -> list[Ended]:
        """Items that have ended since the last call, in no particular order; none after a timeout."""

    @property
    @abstractmethod
    def busy(self) -> int:
        """Number of items under way."""

    def run(
        self, following: Callable[[str], Any] | deque[Any], show: Callable[[int], None] = lambda busy: None
    ) -> Iterator[Ended]:
        """Run items and yield each as it ends, until there is none for a free worker and none under way.

        Args:
            following: the items, or the next one for a worker, by its name; None while there is none. More
                may come while the caller consumes the results.
            show: called with the number of items under way, at least once a second.
        """
        queue = following if isinstance(following, deque) else None
        while True:
            for worker in (free := self.free()):
                item = following(worker) if callable(following) else queue.popleft() if queue else None
                if item is None:
                    break
                self.start(item, worker)
            show(self.busy)
            if free and not self.busy:
                return
            yield from self.wait(_TICK_S)


@dataclass
class _Worker:
    """A process and its item, if it has one."""

    process: Any
    pipe: connection.Connection
    report: Path
    item: Any = None
    started_s: float = 0.0

    @property
    def memory_mb(self) -> float:
        with suppress(psutil.Error):
            return psutil.Process(self.process.pid).memory_info().rss / _MIB
        return 0.0

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


class ProcessPool(Pool):
    """Spawned processes of this machine; a context manager, with whose end they end.

    A process is started with its first item and kept for further ones, unless ``fresh``. One that dies is
    replaced. All die with this process, whatever ends it.

    Args:
        task: called in a worker with an item.
        settings: number of workers and limits.
    """

    def __init__(self, task: Task, settings: PoolSettings) -> None:
        self._task, self._settings = task, settings
        self._workers: dict[str, _Worker] = {}
        self._scratch = scratch_folder()

    def __enter__(self) -> Self:
        self._folder = self._scratch.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        # Items under way are lost: nobody waits for them.
        for worker in self._workers.values():
            worker.end()
        self._scratch.__exit__(*error)

    @property
    def busy(self) -> int:
        return sum(worker.started_s > 0 for worker in self._workers.values())

    def free(self) -> list[str]:
        names = [str(number + 1) for number in range(self._settings.workers)]
        return [name for name in names if name not in self._workers or not self._workers[name].started_s]

    def start(self, item: Any, worker: str) -> None:
        # One that has died, or holds too much memory, is replaced first.
        held = self._workers.get(worker)
        if held is not None and (not held.process.is_alive() or self._is_over(held)):
            self._workers.pop(worker).end()
            held = None
        if held is None:
            held = self._workers[worker] = self._begun(worker)
        held.item, held.started_s = item, time.monotonic()
        with suppress(OSError):  # it has died, which is found below
            held.pipe.send(item)

    def wait(self, timeout_s: float) -> list[Ended]:
        until_s = time.monotonic() + timeout_s
        while True:
            under_way = {name: worker for name, worker in self._workers.items() if worker.started_s}
            ended = [end for name, worker in under_way.items() if (end := self._end_of(name, worker))]
            left_s = until_s - time.monotonic()
            if ended or left_s <= 0:
                return ended
            signs = [sign for w in under_way.values() for sign in (w.pipe, w.process.sentinel)]
            connection.wait(signs, min(left_s, _LOOK_S))

    def _begun(self, name: str) -> _Worker:
        # Spawned, not forked: a process that holds a GL context must not fork.
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        report = self._folder / f"{name}.txt"
        report.unlink(missing_ok=True)
        process = context.Process(target=serve, args=(theirs, self._task, self._settings.time_s, report))
        try:
            with _environment(SINGLE_THREADED if self._settings.single_threaded else {}):
                process.start()
        except OSError as error:
            problem, remedy = f"cannot be started ({error})", "give fewer --workers"
            raise MachineError("a worker process", problem, remedy) from error
        theirs.close()
        return _Worker(process, ours, report)

    def _end_of(self, name: str, worker: _Worker) -> Ended | None:
        """End of a worker's item, if it has ended or is to be ended."""
        alive = worker.process.is_alive()
        try:
            if worker.pipe.poll():
                value, error = worker.pipe.recv()
                item, worker.item, worker.started_s = worker.item, None, 0.0
                if self._settings.fresh:
                    self._workers.pop(name).end()
                return Ended(item, name, value, error, message=error_line(error) if error is not None else "")
        except (EOFError, OSError):
            alive = False
        if not alive:
            return self._death(name)
        limit_s = self._settings.time_s
        if limit_s is not None and time.monotonic() - worker.started_s > limit_s + LATE_S:
            return self._death(name, EndKind.TIMED_OUT)
        if self._is_over(worker):
            return self._death(name, EndKind.OUT_OF_MEMORY)
        return None

    def _is_over(self, worker: _Worker) -> bool:
        limit_mb = self._settings.memory_mb
        return limit_mb is not None and worker.memory_mb > limit_mb

    def _death(self, name: str, fault: EndKind = EndKind.CRASHED) -> Ended:
        worker = self._workers.pop(name)
        held_mb = worker.memory_mb
        if fault is EndKind.CRASHED:
            worker.process.join(_TICK_S)
        code = worker.process.exitcode
        worker.end()
        report = worker.report.read_text(errors="replace").strip() if worker.report.is_file() else ""
        if fault is EndKind.TIMED_OUT or report.startswith("Timeout"):
            fault = EndKind.TIMED_OUT
            message = f"not done after {self._settings.time_s:g} s: its process was ended"
        elif fault is EndKind.OUT_OF_MEMORY:
            message = f"its process was ended at {held_mb:.0f} MiB of memory"
        else:
            told = f": {report.splitlines()[0]}" if report else ""
            message = f"its process has died (exit code {code}){told}"
        return Ended(worker.item, name, None, None, fault, message, report[:_REPORT_CHARACTERS])


def open_pool(task: Task, settings: PoolSettings) -> AbstractContextManager[Pool]:
    """Open the pool that the settings describe: processes of this machine, or workers of a Dask scheduler.

    Raises:
        InputError: the scheduler cannot be used.
    """
    if settings.scheduler is None:
        return ProcessPool(task, settings)
    try:
        from dslab.experiments.jobs.cluster import open_cluster_pool
    except ModuleNotFoundError as error:
        problem = f"{error.name} is not installed, which workers of other machines need"
        raise InputError("--scheduler", problem, "install dual-slam-lab[cluster], or leave it out") from None
    return open_cluster_pool(task, settings)


def run_each(task: Task, items: Iterable[Any], workers: int) -> Iterator[tuple[Any, Any]]:
    """Yield every item with its result, as it ends, from processes of this machine.

    Raises:
        MachineError: a process has died.
        Exception: what the task raises; the other items are lost.
    """
    with ProcessPool(task, PoolSettings(workers)) as pool:
        for ended in pool.run(deque(items)):
            yield ended.item, ended.result()


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set variables that a new process reads as it loads its libraries, and put back what was there."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def error_line(error: Exception) -> str:
    """The exception as one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
