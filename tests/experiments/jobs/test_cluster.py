"""The workers of a Dask scheduler run the same jobs, and every item ends there too."""

import gc
import os
import signal
import sys
from collections import deque
from types import SimpleNamespace

import pytest
from distributed import Client, LocalCluster, Security

from dslab.experiments.jobs import cluster as clusters
from dslab.experiments.jobs.cluster import ClusterPool, open_cluster_pool
from dslab.experiments.jobs.pool import PoolSettings, open_pool
from dslab.experiments.runs.ending import EndKind
from dslab.scenarios.errors import InputError, MachineError


def told(what):
    if what == "raise":
        raise ValueError("told to")
    if what == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
    return what


@pytest.fixture(scope="module")
def scheduler():
    """A scheduler of one worker in this process."""
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster:
        yield cluster.scheduler_address


def test_a_scheduler_is_another_pool(scheduler):
    with open_pool(told, PoolSettings(scheduler=scheduler)) as pool:
        ended = {end.item: end for end in pool.run(deque(["a", "raise", "b"]))}
    assert [ended[item].value for item in "ab"] == ["a", "b"]
    assert isinstance(ended["raise"].error, ValueError) and ended["raise"].message == "ValueError: told to"


@pytest.mark.slow
def test_an_item_whose_process_dies_ends_and_its_worker_is_replaced():
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        settings = PoolSettings(scheduler=cluster.scheduler_address, time_s=60.0)
        with open_pool(told, settings) as pool:
            ended = {end.item: end for end in pool.run(deque(["crash", "fine"]))}
    assert ended["crash"].fault is EndKind.CRASHED and ended["fine"].value == "fine"


def test_a_result_whose_worker_has_gone_is_given_up():
    class Lost:
        key, status = "item", "finished"

        def add_done_callback(self, call):
            call(self)

        def result(self, timeout):
            raise TimeoutError

    client = SimpleNamespace(submit=lambda *_, **__: Lost(), cancel=lambda *_, **__: None, nthreads=dict)
    workers = ClusterPool(client, told, PoolSettings(scheduler="x"))
    workers.start("unit", "gone")
    (ended,) = workers.wait(1.0)
    assert (ended.item, ended.value, ended.message) == ("unit", None, "its process has died")


def test_a_scheduler_without_workers_is_one_line(monkeypatch):
    with LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as cluster:
        monkeypatch.setattr(clusters, "_START_S", 0.1)
        with (
            pytest.raises(MachineError, match=r"has had no worker for 0 s; start one with `dask scheduler`"),
            open_cluster_pool(told, PoolSettings(scheduler=cluster.scheduler_address)),
        ):
            pass


def test_a_missing_scheduler_is_one_line(monkeypatch):
    monkeypatch.setattr(clusters, "_CONNECT_S", 0.3)
    with (
        pytest.raises(InputError, match=r"tcp://127.0.0.1:9: no scheduler answers .*; start one with"),
        open_cluster_pool(told, PoolSettings(scheduler="tcp://127.0.0.1:9")),
    ):
        pass


def test_a_machine_without_dask_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "dslab.experiments.jobs.cluster")
    with pytest.raises(InputError, match="--scheduler: distributed is not installed"):
        open_pool(told, PoolSettings(scheduler="tcp://there:1"))


@pytest.mark.slow
def test_a_scheduler_behind_keys_is_one_line_without_them():
    keys = Security.temporary()
    with LocalCluster(n_workers=1, protocol="tls://", security=keys, dashboard_address=":0") as cluster:
        gc.collect()  # as open_cluster_pool does, and for the same reason
        with (
            pytest.raises(InputError, match=r"reached by TLS only .* name its keys in Dask's configuration"),
            open_cluster_pool(told, PoolSettings(scheduler=cluster.scheduler_address)),
        ):
            pass


@pytest.mark.parametrize("address", ["tls://127.0.0.1:9", "nonsense://x"])
@pytest.mark.slow
def test_no_client_without_a_connection_is_left_to_the_garbage_collector(address):
    gc.collect()
    gc.disable()
    try:
        with pytest.raises(InputError), open_cluster_pool(told, PoolSettings(scheduler=address)):
            pass
        assert not [one for one in gc.get_objects() if isinstance(one, Client) and one.status == "connecting"]
    finally:
        gc.enable()
