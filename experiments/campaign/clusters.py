"""Pools on an embedded cluster of this machine, or on the workers of a Dask scheduler."""

import gc
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from dslab.experiments.campaign.unit_job import Job, Task, unit_record
from dslab.experiments.campaign.worker_pool import WorkerPool, WorkerPoolSettings
from dslab.scenarios.errors import InputError, MachineError
from dslab.sim.unfinished import scratch_folder

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
_START_S = 120.0
_CONNECT_S = 10.0
_TICK_S = 1.0
_NO_KEYS = "is reached by TLS only and no keys are configured"
_NOBODY_S = 600.0
"""Time that an embedded cluster may be without any worker; they start in seconds."""
_STARTS_PER_WORKER = 5
"""Number of processes that a worker may take until one of them begins an item."""


@contextmanager
def open_worker_pool(settings: WorkerPoolSettings, job: Job) -> Iterator[WorkerPool]:
    """Open the pool of units that the settings describe, embedded or remote."""
    open_pool = embedded_worker_pool if settings.scheduler is None else remote_worker_pool
    with open_pool(settings, partial(unit_record, job, cache_dir=settings.cache_dir)) as pool:
        yield pool


@contextmanager
def embedded_worker_pool(settings: WorkerPoolSettings, task: Task) -> Iterator[WorkerPool]:
    """Open a pool of spawned processes; they end with the block.

    They are reached over loopback only, and only with keys that are made for this pool and kept in memory. A
    process that ends is replaced by its nanny or, if that fails, by another nanny.

    Raises:
        MachineError: the processes do not come up.
    """
    from dask import config as dask_config
    from distributed import Client, LocalCluster, Security

    # Numerical libraries read these when they are loaded, before a worker could set them.
    os.environ.update(SINGLE_THREADED)
    limit = 0 if settings.memory_mb is None else settings.memory_mb * 2**20
    # This logger reports connections closed by an interrupt; `silence_logs` does not reach it.
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    with (
        scratch_folder() as folder,
        # The scheduler too keeps files, in the folder named so.
        dask_config.set({**_dask_settings(), "temporary-directory": str(folder)}),
        LocalCluster(
            # Started below: Dask does not close workers cleanly if their start is interrupted here.
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            protocol="tls://",
            security=Security.temporary(),
            memory_limit=limit,
            silence_logs=logging.CRITICAL,
            dashboard_address=None,
            preload=["dslab.experiments.campaign.unit_job"],
            # Dask opens a port for HTTP even without a dashboard: any free one.
            scheduler_kwargs={"allowed_failures": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"},
        ) as cluster,
        Client(cluster) as client,
    ):
        keeper = EmbeddedWorkers(cluster, settings.workers)
        try:
            cluster.scale(settings.workers)
            remedy = "run `dslab doctor`, give fewer --workers, or wait until it is less busy"
            _await(client, settings.workers, "this machine", remedy, keeper.keep_up)
            yield WorkerPool(client, task, settings, folder, keeper)
        except BaseException:
            # The items under way are lost; do not wait for them.
            _kill(cluster)
            raise


class EmbeddedWorkers:
    """The worker processes of an embedded cluster.

    Args:
        cluster: of this process.
        number: of workers wanted.
    """

    def __init__(self, cluster: "LocalCluster", number: int) -> None:
        self._cluster = cluster
        self._number = number
        self._seen_s = time.monotonic()
        self._started: set[int] = set()

    def keep_up(self, present: int = 0) -> None:
        """Replace lost workers.

        Args:
            present: number of workers that the scheduler knows.

        Raises:
            MachineError: there is none for long, or one after another ends before its first item.
        """
        self._started |= {nanny.pid for nanny in self._cluster.workers.values() if nanny.pid is not None}
        if present:
            self._seen_s = time.monotonic()
        if present >= self._number:
            return
        if len(self._started) > self._number * _STARTS_PER_WORKER:
            ended = len(self._started) - self._number
            problem = f"{ended} of its processes in a row have ended before their first unit"
        elif time.monotonic() - self._seen_s > _NOBODY_S:
            problem = f"has had no worker for {_NOBODY_S:.0f} s"
        else:
            self._cluster.scale(self._number)
            return
        remedy = "give them more --memory or fewer --workers, and run the same command again"
        raise MachineError("the embedded cluster", problem, remedy)

    def item_ended(self) -> None:
        """Note that a worker has lived long enough to begin an item."""
        self._started.clear()


@contextmanager
def remote_worker_pool(settings: WorkerPoolSettings, task: Task) -> Iterator[WorkerPool]:
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
        _await(client, 1, address, remedy)
        yield WorkerPool(client, task, settings)


def _connected(address: str) -> "tuple[Client | None, str]":
    """A client of the scheduler at an address, or the reason why there is none."""
    from distributed import Client

    try:
        return Client(address, timeout=_CONNECT_S, set_as_default=False), ""
    except TypeError:
        return None, _NO_KEYS
    except (OSError, TimeoutError, ValueError) as error:
        return None, f"no scheduler answers ({type(error).__name__})"


def _dask_settings() -> dict[str, Any]:
    memory = {"terminate": 1.0, "target": False, "spill": False, "pause": False}
    return {
        **{f"distributed.worker.memory.{name}": value for name, value in memory.items()},
        # On a busy machine a process may take longer to start than the 15 s after which it is dismissed.
        "distributed.deploy.lost-worker-timeout": f"{_START_S:.0f}s",
        # TLS does not cover the ports for HTTP, so nothing is served there.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }


def _await(
    client: Any, workers: int, where: str, remedy: str, check: Callable[[], None] = lambda: None
) -> None:
    begun_s = time.monotonic()
    while True:
        check()
        try:
            client.wait_for_workers(workers, timeout=_TICK_S)
            return
        except TimeoutError:
            if time.monotonic() - begun_s < _START_S:
                continue
        missing = "no worker" if workers == 1 else f"fewer than {workers} workers"
        raise MachineError(where, f"has had {missing} for {_START_S:.0f} s", remedy) from None


def _kill(cluster: Any) -> None:
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, 9)
