"""A pool of Dask worker processes: one item at a time per worker, and every item ends.

An item is bound to its worker, and no worker gets a second one, so a dead process has one cause. Dask itself
retries nothing: the caller decides on retries and counts them.
"""

import queue
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from uuid import uuid4

from dslab.experiments.campaign.unit_job import Task, run_task
from dslab.scenarios.errors import InputError, MachineError

if TYPE_CHECKING:
    from distributed import Client, Future

MEMORY_FLOOR_MB = 400
"""Least memory limit of a worker: it takes 190 MB to start, 250 to 310 MB with all that a unit
imports."""
_START_S = 120.0
_LATE_S = 60.0
"""Time allowed beyond an item's limit; its process should have ended itself by then."""
_TRANSFER_S = 20.0
"""Time that the result of an ended item may take; Dask waits for ever for a worker that has gone."""
_ABSENT_S = 5.0
"""Time that a worker must be gone before its item is given up; its result may still arrive."""
_REPORT_CHARACTERS = 16_000


@dataclass(frozen=True)
class WorkerPoolSettings:
    """Settings of a worker pool.

    Attributes:
        workers: number of processes of the embedded cluster.
        scheduler: address of a scheduler to use instead, such as ``tcp://10.0.0.1:8786``.
        timeout_s: longest duration of an item.
        memory_mb: resident memory at which a worker of the embedded cluster is ended; None for no limit.
        cache_dir: folder of rendered sequences; None for each machine's default one.

    Raises:
        InputError: no unit could run with such a limit.
    """

    workers: int = 1
    scheduler: str | None = None
    timeout_s: float = 1800.0
    memory_mb: int | None = 4000
    cache_dir: Path | None = None

    def __post_init__(self) -> None:
        if self.memory_mb is not None and self.memory_mb < MEMORY_FLOOR_MB:
            raise InputError(
                "--memory",
                f"{self.memory_mb} MB is less than the {MEMORY_FLOOR_MB} MB that a worker takes to start",
                "give megabytes, for example 4000, or 0 for no limit",
            )
        if not 0 < self.timeout_s <= threading.TIMEOUT_MAX:
            raise InputError("--timeout", f"{self.timeout_s:g} s is no time limit", "give seconds")


class Keeper(Protocol):
    """Owner of the worker processes of a pool, who replaces those that are lost."""

    def keep_up(self, present: int) -> None:
        """Replace lost workers.

        Args:
            present: number of workers that the scheduler knows.

        Raises:
            MachineError: they do not start, or end before their first item.
        """
        ...

    def item_ended(self) -> None:
        """Note that a worker has lived long enough to begin an item."""
        ...


@dataclass(frozen=True)
class Ended:
    """An item that has ended.

    Attributes:
        item, worker: the item, and the address of its worker.
        result: of the task; None if it raised or its process died.
        message, report: of a failure: one line, and the stacks of the threads if known.
        timed_out: the process was ended because the item took too long.
    """

    item: Any
    worker: str
    result: Any
    message: str = ""
    report: str = ""
    timed_out: bool = False


@dataclass
class _Assignment:
    """The item that a worker is running."""

    item: Any
    future: "Future"
    report: Path | None
    started_s: float
    absent_since_s: float | None = None


class WorkerPool:
    """Workers, each with one item or none.

    Args:
        client: of the cluster.
        task: called in a worker with an item.
        settings: limits and folders.
        reports: folder shared with the workers, for the stacks of a dying one; None for none.
        keeper: of the worker processes; None if the pool does not own them.
    """

    def __init__(
        self,
        client: "Client",
        task: Task,
        settings: WorkerPoolSettings,
        reports: Path | None = None,
        keeper: Keeper | None = None,
    ) -> None:
        self._client = client
        self._task = task
        self._settings = settings
        self._reports = reports
        self._keeper = keeper
        self._assigned: dict[str, _Assignment] = {}
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()

    @property
    def busy(self) -> int:
        """Number of items under way."""
        return len(self._assigned)

    def workers(self) -> list[str]:
        """Addresses of the present workers.

        Raises:
            MachineError: the scheduler is gone, or the workers of an embedded cluster do not start.
        """
        try:
            found = sorted(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            raise MachineError(
                self._settings.scheduler or "the embedded cluster",
                f"the scheduler is gone ({error})",
                "start it again and run the same command again",
            ) from error
        if self._keeper is not None:
            self._keeper.keep_up(len(found))
        return found

    def free(self) -> list[str]:
        """Addresses of the workers without an item."""
        return [worker for worker in self.workers() if worker not in self._assigned]

    def start(self, item: Any, worker: str, **options: Any) -> None:
        """Give an item, with options of the task, to a free worker."""
        key = f"item-{uuid4().hex}"
        report = None if self._reports is None else self._reports / f"{key}.txt"
        future = self._client.submit(
            run_task, self._task, item, self._settings.timeout_s, report, options,
            key=key, pure=False, workers=[worker], allow_other_workers=False,
        )  # fmt: skip
        self._assigned[worker] = _Assignment(item, future, report, time.monotonic())
        future.add_done_callback(lambda _: self._ended.put(worker))

    def run(self, waiting: deque[Any], **options: Any) -> Iterator[Ended]:
        """Run items and yield each as it ends.

        Args:
            waiting: the items; the caller may add more while it consumes the results.
            options: of the task.
        """
        while waiting or self.busy:
            for worker in self.free()[: len(waiting)]:
                self.start(waiting.popleft(), worker, **options)
            yield from self.wait(1.0)

    def wait(self, timeout_s: float) -> list[Ended]:
        """Items that have ended since the last call, in no particular order; none after a timeout."""
        workers: list[str] = []
        with suppress(queue.Empty):
            workers.append(self._ended.get(timeout=timeout_s))
            while True:
                workers.append(self._ended.get_nowait())
        ended = [self._end(worker) for worker in workers if worker in self._assigned] + self._overdue()
        if ended and self._keeper is not None:
            self._keeper.item_ended()
        return ended

    def _end(self, worker: str) -> Ended:
        assignment = self._assigned.pop(worker)
        status = assignment.future.status
        if status == "finished":
            try:
                return Ended(assignment.item, worker, assignment.future.result(_TRANSFER_S))
            except Exception:  # its process died before the result was transferred
                return self._death(assignment, worker, self._cause(worker))
        error = assignment.future.exception() if status == "error" else None
        if error is None or type(error).__name__ == "KilledWorker":
            return self._death(assignment, worker)
        return Ended(assignment.item, worker, None, f"{type(error).__name__}: {error}".replace("\n", " "))

    def _death(self, assignment: _Assignment, worker: str, message: str = "") -> Ended:
        report = ""
        if assignment.report is not None and assignment.report.is_file():
            report = assignment.report.read_text(errors="replace").strip()[:_REPORT_CHARACTERS]
        late = time.monotonic() - assignment.started_s >= self._settings.timeout_s
        timed_out = not message and (late or report.startswith("Timeout"))
        if timed_out:
            message = f"not done after {self._settings.timeout_s:g} s: its process was ended"
        message = message or self._cause(worker, report)
        return Ended(assignment.item, worker, None, message, report, timed_out)

    def _cause(self, worker: str, report: str = "") -> str:
        with suppress(OSError, TimeoutError):
            events: Any = self._client.get_events("worker-restart-memory")
            for _, event in events:
                if event["worker"] == worker:
                    return f"its process was ended at {event['rss'] / 2**20:.0f} MiB of memory"
        return "its process has died" + (f": {report.splitlines()[0]}" if report else "")

    def _overdue(self) -> list[Ended]:
        """Give up items whose worker has left, or is late and does not end itself."""
        if not self._assigned:
            return []
        now_s, present = time.monotonic(), set(self.workers())
        given_up = []
        for worker, assignment in self._assigned.items():
            if worker in present:
                assignment.absent_since_s = None
                if now_s - assignment.started_s > self._settings.timeout_s + _LATE_S:
                    given_up.append(worker)
            elif assignment.absent_since_s is None:
                assignment.absent_since_s = now_s
            elif now_s - assignment.absent_since_s > _ABSENT_S:
                given_up.append(worker)
        return [self._give_up(worker, worker in present) for worker in given_up]

    def _give_up(self, worker: str, alive: bool) -> Ended:
        assignment = self._assigned.pop(worker)
        self._client.cancel([assignment.future], force=True)
        if alive:
            self._client.restart_workers([worker], timeout=_START_S, raise_for_error=False)
            return self._death(assignment, worker)
        return self._death(assignment, worker, "its worker has left")
