"""A pool of the workers of a Dask scheduler, on any machines; the only user of Dask."""

import gc
import queue
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from distributed import Client, Future

from dslab.experiments.jobs.pool import LATE_S, Ended, Pool, PoolSettings, error_line
from dslab.experiments.jobs.worker import Task, run_watched
from dslab.experiments.runs.ending import EndKind
from dslab.scenarios.errors import InputError, MachineError

_START_S = 120.0
_CONNECT_S = 10.0
_TRANSFER_S = 20.0
"""Time that the result of an ended item may take; Dask waits for ever for a worker that has gone."""
_ABSENT_S = 5.0
"""Time that a worker must be gone before its item is given up; its result may still arrive."""
_NO_KEYS = "is reached by TLS only and no keys are configured"


@contextmanager
def open_cluster_pool(task: Task, settings: PoolSettings) -> Iterator["ClusterPool"]:
    """Open a pool of a scheduler's workers, whose number may change at any time.

    The keys for ``tls://`` are those of Dask's own configuration.

    Raises:
        InputError: there is no scheduler at the address, it refuses the keys, or no worker comes.
    """
    address = str(settings.scheduler)
    remedy = "start one with `dask scheduler` and workers with `dask worker`, or leave --scheduler out"
    client, problem = _connected(address)
    if client is None:
        # What is left of it stays in a cycle. Collected while Dask starts a thread for another client, its
        # finalizer waits for a lock that this start holds.
        gc.collect()
        if problem == _NO_KEYS:
            remedy = "name its keys in Dask's configuration (distributed.comm.tls)"
        raise InputError(address, problem, remedy)
    with client:
        try:
            client.wait_for_workers(1, timeout=_START_S)
        except TimeoutError:
            raise MachineError(address, f"has had no worker for {_START_S:.0f} s", remedy) from None
        yield ClusterPool(client, task, settings)


@dataclass
class _Assignment:
    """The item that a worker is running."""

    item: Any
    future: Future
    started_s: float
    absent_since_s: float | None = None


class ClusterPool(Pool):
    """Workers of a scheduler. An item is bound to its worker, and Dask itself retries nothing.

    Args:
        client: of the scheduler.
        task: called in a worker with an item.
        settings: limit of time, and the scheduler's address.
    """

    def __init__(self, client: Client, task: Task, settings: PoolSettings) -> None:
        self._client, self._task, self._settings = client, task, settings
        self._assigned: dict[str, _Assignment] = {}
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()

    @property
    def busy(self) -> int:
        return len(self._assigned)

    def free(self) -> list[str]:
        return [worker for worker in self._present() if worker not in self._assigned]

    def start(self, item: Any, worker: str) -> None:
        future = self._client.submit(
            run_watched, self._task, item, self._settings.time_s,
            key=f"item-{uuid4().hex}", pure=False, workers=[worker], allow_other_workers=False,
        )  # fmt: skip
        self._assigned[worker] = _Assignment(item, future, time.monotonic())
        future.add_done_callback(lambda _: self._ended.put(worker))

    def wait(self, timeout_s: float) -> list[Ended]:
        workers: list[str] = []
        with suppress(queue.Empty):
            workers.append(self._ended.get(timeout=timeout_s))
            while True:
                workers.append(self._ended.get_nowait())
        return [self._end(worker) for worker in workers if worker in self._assigned] + self._overdue()

    def _present(self) -> list[str]:
        try:
            return sorted(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            problem, remedy = (
                f"the scheduler is gone ({error})",
                "start it again and run the same command again",
            )
            raise MachineError(str(self._settings.scheduler), problem, remedy) from error

    def _end(self, worker: str) -> Ended:
        assignment = self._assigned.pop(worker)
        if assignment.future.status == "finished":
            try:
                return Ended(assignment.item, worker, assignment.future.result(_TRANSFER_S))
            except Exception:  # its process died before the result was transferred
                return self._death(assignment, worker)
        error = assignment.future.exception() if assignment.future.status == "error" else None
        if isinstance(error, Exception) and type(error).__name__ != "KilledWorker":
            return Ended(assignment.item, worker, None, error, message=error_line(error))
        return self._death(assignment, worker)

    def _death(self, assignment: _Assignment, worker: str, message: str = "its process has died") -> Ended:
        limit_s = self._settings.time_s
        if limit_s is not None and time.monotonic() - assignment.started_s >= limit_s:
            message = f"not done after {limit_s:g} s: its process was ended"
            return Ended(assignment.item, worker, fault=EndKind.TIMED_OUT, message=message)
        return Ended(assignment.item, worker, fault=EndKind.CRASHED, message=message)

    def _overdue(self) -> list[Ended]:
        """Give up items whose worker has left, or is late and does not end itself."""
        if not self._assigned:
            return []
        now_s, present, limit_s = time.monotonic(), set(self._present()), self._settings.time_s
        given_up = []
        for worker, assignment in self._assigned.items():
            if worker in present:
                assignment.absent_since_s = None
                if limit_s is not None and now_s - assignment.started_s > limit_s + LATE_S:
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
        return self._death(assignment, worker, "its process has died" if alive else "its worker has left")


def _connected(address: str) -> tuple[Client | None, str]:
    """A client of the scheduler at an address, or the reason why there is none."""
    try:
        return Client(address, timeout=_CONNECT_S, set_as_default=False), ""
    except TypeError:
        return None, _NO_KEYS
    except (OSError, TimeoutError, ValueError) as error:
        return None, f"no scheduler answers ({type(error).__name__})"
