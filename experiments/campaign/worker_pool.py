"""Units in processes of Dask: one at a time per worker, each brought to an end one way or another.

A unit is bound to the worker that it is given to and no worker gets a second one, so a death has one culprit.
Dask itself tries nothing again: how often a unit is tried is for the caller to say, and to count.
"""

import logging
import os
import queue
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from experiments.campaign.unit_job import Job, run_job
from experiments.eq1.units import UnitSpec
from scenarios.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, Future

SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
_START_S = 120.0
_CONNECT_S = 10.0
_LATE_S = 60.0
"""How long after its time is up a unit may go on: its process should have ended itself."""
_ABSENT_S = 5.0
"""How long a worker must be gone before its unit is given up: word of its end may be under way."""
_NOBODY_S = 600.0
"""How long an embedded cluster may be without any worker: they start in seconds."""
_REPORT_CHARACTERS = 16_000


@dataclass(frozen=True)
class WorkerPoolSettings:
    """What runs the units.

    Attributes:
        workers: processes of the embedded cluster.
        scheduler: address of a scheduler to use in place of it, such as ``tcp://10.0.0.1:8786``.
        timeout_s: the longest that a unit may take.
        memory_mb: resident memory at which a worker of the embedded cluster is ended; None for no limit.
        cache_dir: of rendered sequences; None for the default one of every machine.
    """

    workers: int = 1
    scheduler: str | None = None
    timeout_s: float = 1800.0
    memory_mb: int | None = 4000
    cache_dir: Path | None = None


@dataclass(frozen=True)
class Ended:
    """A unit that has ended.

    Attributes:
        unit, worker: which and where.
        record: as it gave it; None where its process has died.
        message, report: of a death: one line, and where its threads were as far as known.
    """

    unit: UnitSpec
    worker: str
    record: dict[str, Any] | None
    message: str = ""
    report: str = ""


@dataclass
class _Post:
    """A worker with the unit that it is at."""

    unit: UnitSpec
    future: "Future"
    report: Path | None
    began_s: float
    absent_since_s: float | None = None


class WorkerPool:
    """Workers, each at one unit or none. Made by :func:`open_worker_pool`.

    Args:
        client: of the cluster.
        job: what runs a unit.
        settings: limits and places.
        reports: folder that workers share with this process, for what a dying one has to say.
        replace_lost: starts workers anew that are missing; None where that is for others to do.
    """

    def __init__(
        self,
        client: "Client",
        job: Job,
        settings: WorkerPoolSettings,
        reports: Path | None = None,
        replace_lost: Callable[[], None] | None = None,
    ) -> None:
        self._client = client
        self._job = job
        self._settings = settings
        self._reports = reports
        self._replace_lost = replace_lost
        self._last_seen_s = time.monotonic()
        self._posts: dict[str, _Post] = {}
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()

    @property
    def busy(self) -> int:
        """Units under way."""
        return len(self._posts)

    def workers(self) -> list[str]:
        """Addresses of the workers that are there now.

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
        """Workers that are at no unit."""
        return [worker for worker in self.workers() if worker not in self._posts]

    def start(self, unit: UnitSpec, worker: str, recording: Path | None = None) -> None:
        """Give a unit to a free worker."""
        key = f"{unit.unit_id}-{uuid4().hex[:8]}"
        report = None if self._reports is None else self._reports / f"{key}.txt"
        settings = self._settings
        future = self._client.submit(
            run_job, self._job, unit, settings.timeout_s, settings.cache_dir, recording, report,
            key=key, pure=False, workers=[worker], allow_other_workers=False,
        )  # fmt: skip
        self._posts[worker] = _Post(unit, future, report, time.monotonic())
        future.add_done_callback(lambda _: self._ended.put(worker))

    def wait(self, timeout_s: float) -> list[Ended]:
        """Units that have ended since, in no particular order; after the time given there may be none."""
        workers: list[str] = []
        with suppress(queue.Empty):
            workers.append(self._ended.get(timeout=timeout_s))
            while True:
                workers.append(self._ended.get_nowait())
        return [self._end(worker) for worker in workers if worker in self._posts] + self._overdue()

    def _end(self, worker: str) -> Ended:
        post = self._posts.pop(worker)
        status = post.future.status
        if status == "finished":
            try:
                return Ended(post.unit, worker, post.future.result())
            except Exception as error:  # its process died between the end of the unit and the handing over
                return self._death(post, worker, f"its result was lost: {error}")
        error = post.future.exception() if status == "error" else None
        if error is None or type(error).__name__ == "KilledWorker":
            return self._death(post, worker)
        return Ended(post.unit, worker, None, f"{type(error).__name__}: {error}".replace("\n", " "))

    def _death(self, post: _Post, worker: str, message: str = "") -> Ended:
        report = ""
        if post.report is not None and post.report.is_file():
            report = post.report.read_text(errors="replace").strip()[:_REPORT_CHARACTERS]
        if not message:
            message = self._cause(post, worker, report)
        return Ended(post.unit, worker, None, message, report)

    def _cause(self, post: _Post, worker: str, report: str) -> str:
        if report.startswith("Timeout") or time.monotonic() - post.began_s >= self._settings.timeout_s:
            return f"not done after {self._settings.timeout_s:g} s: its process was ended"
        with suppress(OSError, TimeoutError):
            events: Any = self._client.get_events("worker-restart-memory")
            for _, event in events:
                if event["worker"] == worker:
                    return f"its process was ended at {event['rss'] / 2**20:.0f} MiB of memory"
        return "its process has died" + (f": {report.splitlines()[0]}" if report else "")

    def _overdue(self) -> list[Ended]:
        """Units that no word will come of: their worker has left, or does not end itself."""
        if not self._posts:
            return []
        now_s, there = time.monotonic(), set(self.workers())
        given_up = []
        for worker, post in self._posts.items():
            if worker in there:
                post.absent_since_s = None
                if now_s - post.began_s > self._settings.timeout_s + _LATE_S:
                    given_up.append(worker)
            elif post.absent_since_s is None:
                post.absent_since_s = now_s
            elif now_s - post.absent_since_s > _ABSENT_S:
                given_up.append(worker)
        return [self._give_up(worker, worker in there) for worker in given_up]

    def _give_up(self, worker: str, alive: bool) -> Ended:
        post = self._posts.pop(worker)
        self._client.cancel([post.future], force=True)
        if alive:
            self._client.restart_workers([worker], timeout=_START_S, raise_for_error=False)
            return self._death(post, worker)
        return self._death(post, worker, "its worker has left")


@contextmanager
def open_worker_pool(settings: WorkerPoolSettings, job: Job) -> Iterator[WorkerPool]:
    """The crew that the settings ask for."""
    with (embedded_worker_pool if settings.scheduler is None else remote_worker_pool)(settings, job) as pool:
        yield pool


@contextmanager
def embedded_worker_pool(settings: WorkerPoolSettings, job: Job) -> Iterator[WorkerPool]:
    """Spawned processes of this machine, reached over loopback only; ended with the block.

    A process that ends is replaced by its nanny; where that fails, by another nanny.

    Raises:
        InputError: the processes do not come up.
    """
    from dask import config as dask_config
    from distributed import Client, LocalCluster

    # Numerical libraries read these as they are loaded, before a worker could set them for itself.
    os.environ.update(SINGLE_THREADED)
    memory = {"terminate": 1.0, "target": False, "spill": False, "pause": False}
    config = {f"distributed.worker.memory.{name}": value for name, value in memory.items()}
    # On a busy machine a process may take longer to start than the 15 s after which its nanny is dismissed.
    config["distributed.deploy.lost-worker-timeout"] = f"{_START_S:.0f}s"
    limit = 0 if settings.memory_mb is None else settings.memory_mb * 2**20
    # It tells of connections that an interrupt ends; `silence_logs` does not reach it.
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    with (
        dask_config.set(config),
        tempfile.TemporaryDirectory(prefix="dslab-") as folder,
        LocalCluster(
            # Started below, as Dask does not close workers cleanly whose start is interrupted in here.
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            protocol="tcp://",
            memory_limit=limit,
            silence_logs=logging.CRITICAL,
            dashboard_address=None,
            preload=["experiments.campaign.unit_job"],
            local_directory=folder,
            # What answers about health needs a port even without a dashboard: any that is free.
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
            yield WorkerPool(client, job, settings, Path(folder), lambda: cluster.scale(settings.workers))
        except BaseException:
            # What is under way is lost: no need to wait until it notices.
            _kill(cluster)
            raise


@contextmanager
def remote_worker_pool(settings: WorkerPoolSettings, job: Job) -> Iterator[WorkerPool]:
    """The workers of a scheduler, as many as there are at any time.

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
        yield WorkerPool(client, job, settings)


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
