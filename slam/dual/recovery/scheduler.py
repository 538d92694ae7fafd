"""Scheduler of recovery threads, which run side by side beside tracking, as far as there are workers.

In lockstep mode workers are reckoned: a run counts as ended when its cost model says that it would have
ended, so that results do not depend on the load of the machine, and it is computed once its end matters. In
threaded mode workers are threads.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from math import inf

from dslab.slam.core.timing import StageTimer
from dslab.slam.dual.recovery.interface import RecoveryResult, RecoveryTask, RecoveryThread
from dslab.slam.runtime.backend import ExecutionMode
from dslab.slam.runtime.worker import Worker

# Tracking and mapping come first: with two cores a frame takes 16 ms beside a recovery, else 23.
_NICENESS = 10


@dataclass(eq=False)
class RecoveryRun:
    """One run of a recovery thread.

    Attributes:
        number: position of the thread in its list, from 1; where workers are few, lower numbers go first.
        thread: the thread.
        task: its input, which nothing else changes.
        submitted_s: time from which it may run.
        started_s: time at which it was given a worker; None while it waits for one.
        result: what the thread returned; None before.
        cpu_ms: CPU milliseconds that took, with those that others had spent on its images before.
        is_over: its end was reported.
    """

    number: int
    thread: RecoveryThread
    task: RecoveryTask
    submitted_s: float
    started_s: float | None = None
    result: RecoveryResult | None = field(default=None, repr=False)
    cpu_ms: float = 0.0
    is_over: bool = False

    def execute(self) -> RecoveryResult:
        """The result; the thread is run if it was not."""
        if self.result is None:
            timer = StageTimer()
            with timer("recovery"):
                result = self.thread.run(self.task)
            self.cpu_ms = timer.cpu_ms["recovery"] + self.task.reused.cpu_ms
            self.result = result  # last: whoever sees it sees the rest
        return self.result

    @property
    def ends_s(self) -> float:
        """Time at which it ends by its cost model; infinity while it waits for a worker."""
        return inf if self.started_s is None else self.started_s + self.thread.cost.seconds(self.execute())


class RecoveryScheduler(ABC):
    """Gives runs to workers, the lowest thread number first, then the oldest."""

    def __init__(self) -> None:
        self._waiting: list[RecoveryRun] = []

    def submit(self, run: RecoveryRun) -> None:
        """Put a run into the queue."""
        self._waiting.append(run)
        self._waiting.sort(key=lambda r: r.number)  # stable: the oldest first

    def _drop(self, run: RecoveryRun) -> None:
        self._waiting = [r for r in self._waiting if r is not run]

    @abstractmethod
    def start(self, now_s: float) -> list[RecoveryRun]:
        """Give the waiting runs to workers that are free; those that were given one."""

    @abstractmethod
    def has_ended(self, run: RecoveryRun, now_s: float) -> bool:
        """True if a run has ended by now. Raises the exception of a run."""

    @abstractmethod
    def cancel(self, run: RecoveryRun, now_s: float) -> None:
        """Give up a run that has not ended; its worker is free from now on, or soon."""

    @abstractmethod
    def wait(self) -> None:
        """Wait until every run that was given a worker has ended. Raises the exception of a run."""

    @abstractmethod
    def close(self) -> None:
        """Stop the workers; runs that wait are dropped."""


def build_scheduler(mode: ExecutionMode, workers: int) -> RecoveryScheduler:
    """Build the scheduler of a mode, for so many runs at a time."""
    return (ThreadedScheduler if mode is ExecutionMode.THREADED else ReckonedScheduler)(workers)


class ReckonedScheduler(RecoveryScheduler):
    """Scheduler of lockstep mode."""

    def __init__(self, workers: int) -> None:
        super().__init__()
        self._free_since_s = [-inf] * workers
        self._running: list[RecoveryRun] = []

    def start(self, now_s: float) -> list[RecoveryRun]:
        started = []
        while self._waiting and self._free_worker(now_s):
            run = self._waiting.pop(0)
            run.started_s = max(run.submitted_s, self._free_since_s.pop())
            self._running.append(run)
            started.append(run)
        return started

    def has_ended(self, run: RecoveryRun, now_s: float) -> bool:
        return run.started_s is not None and run.ends_s <= now_s

    def cancel(self, run: RecoveryRun, now_s: float) -> None:
        self._drop(run)
        if run in self._running:
            self._running.remove(run)
            self._free_since_s.append(now_s)

    def wait(self) -> None:
        """Nothing to wait for: a run is computed when its end is asked for."""

    def close(self) -> None:
        """Nothing to stop."""

    def _free_worker(self, now_s: float) -> bool:
        """True if a worker is free by now; if all have runs, their ends must be known for that."""
        if not self._free_since_s:
            first = min(self._running, key=lambda r: r.ends_s)
            if first.ends_s <= now_s:
                self._running.remove(first)
                self._free_since_s.append(first.ends_s)
        return bool(self._free_since_s)


class ThreadedScheduler(RecoveryScheduler):
    """Scheduler of threaded mode."""

    def __init__(self, workers: int) -> None:
        super().__init__()
        self._workers = [Worker(f"recovery {n}", _NICENESS) for n in range(1, workers + 1)]

    def start(self, now_s: float) -> list[RecoveryRun]:
        started = []
        for worker in self._workers:
            if self._waiting and not worker.pending:
                run = self._waiting.pop(0)
                run.started_s = now_s
                worker.submit(run.execute)
                started.append(run)
        return started

    def has_ended(self, run: RecoveryRun, now_s: float) -> bool:
        for worker in self._workers:
            worker.check()
        return run.result is not None

    def cancel(self, run: RecoveryRun, now_s: float) -> None:
        self._drop(run)
        run.task.cancellation.requested = True

    def wait(self) -> None:
        for worker in self._workers:
            worker.drain()

    def close(self) -> None:
        for worker in self._workers:
            worker.close()
