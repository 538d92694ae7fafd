"""A pool of Dask worker processes: one item at a time per worker, and every item ends.

An item is bound to its worker, and no worker gets a second one, so a dead process has one cause. Dask itself
retries nothing: the caller decides on retries and counts them.
"""

import logging
import os
import queue
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from experiments.campaign.unit_job import Job, Task, run_task, unit_record
from scenarios.errors import InputError
from sim.unfinished import scratch_folder

if TYPE_CHECKING:
    from distributed import Client, Future

SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
_START_S = 120.0
_CONNECT_S = 10.0
_LATE_S = 60.0
"""Time allowed beyond an item's limit; its process should have ended itself by then."""
_ABSENT_S = 5.0
"""Time that a worker must be gone before its item is given up; its result may still arrive."""
_NOBODY_S = 600.0
"""Time that an embedded cluster may be without any worker; they start in seconds."""
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
    """

    workers: int = 1
    scheduler: str | None = None
    timeout_s: float = 1800.0
    memory_mb: int | None = 4000
    cache_dir: Path | None = None


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
        replace_lost: starts missing workers again; None if the pool does not own them.
    """

    def __init__(
        self,
        client: "Client",
        task: Task,
        settings: WorkerPoolSettings,
        reports: Path | None = None,
        replace_lost: Callable[[], None] | None = None,
    ) -> None:
        self._client = client
        self._task = task
        self._settings = settings
        self._reports = reports
        self._replace_lost = replace_lost
        self._last_seen_s = time.monotonic()
        self._assigned: dict[str, _Assignment] = {}
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()

    @property
    def busy(self) -> int:
        """Number of items under way."""
        return len(self._assigned)

    def workers(self) -> list[str]:
        """Addresses of the present workers.

        Raises:
            InputError: the scheduler is gone, or the workers of an embedded cluster do not start.
        """
        try:
            found = sorted(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            raise InputError(
                self._settings.scheduler or "the embedded cluster",
                f"the scheduler is gone ({error})",
                "start it again and run the same command again",
            ) from error
        if found:
            self._last_seen_s = time.monotonic()
        if self._replace_lost is not None and len(found) < self._settings.workers:
            if time.monotonic() - self._last_seen_s > _NOBODY_S:
                raise InputError(
                    "the embedded cluster",
                    f"has had no worker for {_NOBODY_S:.0f} s",
                    "give them more memory or fewer workers, and run the same command again",
                )
            self._replace_lost()
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
        return [self._end(worker) for worker in workers if worker in self._assigned] + self._overdue()

    def _end(self, worker: str) -> Ended:
        assignment = self._assigned.pop(worker)
        status = assignment.future.status
        if status == "finished":
            try:
                return Ended(assignment.item, worker, assignment.future.result())
            except Exception as error:  # its process died before the result was transferred
                return self._death(assignment, worker, f"its result was lost: {error}")
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

    def _cause(self, worker: str, report: str) -> str:
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


@contextmanager
def open_worker_pool(settings: WorkerPoolSettings, job: Job) -> Iterator[WorkerPool]:
    """Open the pool of units that the settings describe, embedded or remote."""
    open_pool = embedded_worker_pool if settings.scheduler is None else remote_worker_pool
    with open_pool(settings, partial(unit_record, job, cache_dir=settings.cache_dir)) as pool:
        yield pool


@contextmanager
def embedded_worker_pool(settings: WorkerPoolSettings, task: Task) -> Iterator[WorkerPool]:
    """Open a pool of spawned processes, reached over loopback only; they end with the block.

    A process that ends is replaced by its nanny or, if that fails, by another nanny.

    Raises:
        InputError: the processes do not come up.
    """
    from dask import config as dask_config
    from distributed import Client, LocalCluster

    # Numerical libraries read these when they are loaded, before a worker could set them.
    os.environ.update(SINGLE_THREADED)
    memory = {"terminate": 1.0, "target": False, "spill": False, "pause": False}
    config = {f"distributed.worker.memory.{name}": value for name, value in memory.items()}
    # On a busy machine a process may take longer to start than the 15 s after which its nanny is dismissed.
    config["distributed.deploy.lost-worker-timeout"] = f"{_START_S:.0f}s"
    limit = 0 if settings.memory_mb is None else settings.memory_mb * 2**20
    # This logger reports connections closed by an interrupt; `silence_logs` does not reach it.
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    with (
        dask_config.set(config),
        scratch_folder() as folder,
        LocalCluster(
            # Started below: Dask does not close workers cleanly if their start is interrupted here.
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            protocol="tcp://",
            memory_limit=limit,
            silence_logs=logging.CRITICAL,
            dashboard_address=None,
            preload=["experiments.campaign.unit_job"],
            local_directory=str(folder),
            # The health routes need a port even without a dashboard: any free one.
            scheduler_kwargs={"allowed_failures": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"},
        ) as cluster,
        Client(cluster) as client,
    ):
        try:
            cluster.scale(settings.workers)
            _await(
                client,
                settings.workers,
                "this machine",
                "run `dslab doctor`, give fewer --workers, or wait until it is less busy",
            )
            yield WorkerPool(client, task, settings, folder, lambda: cluster.scale(settings.workers))
        except BaseException:
            # The items under way are lost; do not wait for them.
            _kill(cluster)
            raise


@contextmanager
def remote_worker_pool(settings: WorkerPoolSettings, task: Task) -> Iterator[WorkerPool]:
    """Open a pool of a scheduler's workers, whose number may change at any time.

    Raises:
        InputError: there is no scheduler at the address, or no worker comes.
    """
    from distributed import Client

    address = str(settings.scheduler)
    remedy = "start one with `dask scheduler` and workers with `dask worker`, or leave --scheduler out"
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(address, f"no scheduler answers ({type(error).__name__})", remedy) from error
    with client:
        _await(client, 1, address, remedy)
        yield WorkerPool(client, task, settings)


def _await(client: Any, workers: int, where: str, remedy: str) -> None:
    try:
        client.wait_for_workers(workers, timeout=_START_S)
    except TimeoutError:
        missing = "no worker" if workers == 1 else f"fewer than {workers} workers"
        raise InputError(where, f"has had {missing} for {_START_S:.0f} s", remedy) from None


def _kill(cluster: Any) -> None:
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, 9)
