"""Runs of synthetic units in real processes: the same rows for any number of workers and runs."""

import gc
import os
import subprocess
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from urllib.error import HTTPError
from urllib.request import urlopen

import psutil
import pytest
from dask import config
from distributed import Client, Security
from unit_fakes import MadeUp, OneWorker, made_up_record, made_up_unit, rows_of

from dslab.experiments.campaign import clusters
from dslab.experiments.campaign.folder import SPEC_FILE, claim_folder
from dslab.experiments.campaign.folder_lock import sole_driver
from dslab.experiments.campaign.ledger import LEDGER_FILE
from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.campaign.unit_job import unit_record
from dslab.experiments.campaign.worker_pool import WorkerPool, WorkerPoolSettings
from dslab.experiments.eq1.records import decided
from dslab.scenarios.errors import InputError

PLAN = MadeUp({"ok": 25, "slow-0.01": 25})


def test_an_emptied_ledger_is_refused_and_one_that_was_never_begun_is_not(run_made_up, tmp_path):
    folder = tmp_path / "x"
    folder.mkdir()
    (folder / LEDGER_FILE).touch()
    plan = MadeUp({"ok": 2})
    assert run_made_up(plan).ended_here == 2
    (folder / LEDGER_FILE).write_bytes(b"")
    with pytest.raises(InputError, match=r"ledger.sqlite: is empty: its rows are lost; put a copy back"):
        run_made_up(plan)
    assert (folder / LEDGER_FILE).read_bytes() == b""


def test_one_worker_and_two_give_the_same_rows(shared_pool, tmp_path):
    for kind in (OneWorker, WorkerPool):
        pool = kind(shared_pool._client, partial(unit_record, made_up_unit), WorkerPoolSettings(workers=2))
        tally = run_experiment(PLAN, tmp_path / kind.__name__, lambda pool=pool: nullcontext(pool))
        assert tally.done == tally.total == 50
    one, two = (rows_of(tmp_path / kind.__name__, PLAN) for kind in (OneWorker, WorkerPool))
    assert one == two
    assert all(row == decided(made_up_record(PLAN.unit(row["cell"], row["index"]))) for row in one)


def test_a_run_resumes_and_opens_no_workers_when_all_is_done(run_made_up, tmp_path):
    folder = tmp_path / "x"

    def interrupt(tally):
        if tally.ended_here >= 5:
            raise KeyboardInterrupt

    plan = MadeUp({"ok": 10})
    with pytest.raises(KeyboardInterrupt):
        run_made_up(plan, show=interrupt)
    before = rows_of(folder, plan)
    assert 5 <= len(before) < 10
    assert run_made_up(plan).ended_here == 10 - len(before)
    assert len(rows_of(folder, plan)) == 10 and all(row in rows_of(folder, plan) for row in before)

    def nobody():
        raise AssertionError("no workers are needed")

    assert run_experiment(plan, folder, nobody).done == 10
    assert run_experiment(replace(plan, cells={"ok": 7}), folder, nobody).total == 7


def test_errors_given_up_are_tried_again_on_request_only(run_made_up, tmp_path):
    plan = MadeUp({"error-5": 1, "ok": 2})
    assert run_made_up(plan).errors == 1
    assert run_made_up(plan).ended_here == 0
    tally = run_made_up(plan, retry_errors=True)
    assert (tally.ended_here, tally.errors, tally.retries) == (1, 0, 1)


def test_a_folder_of_another_spec_or_with_other_files_or_in_use_is_refused(run_made_up, tmp_path):
    plan, folder = MadeUp({"ok": 2}), tmp_path / "x"
    run_made_up(plan)
    spec, before = (folder / SPEC_FILE).read_text(), rows_of(folder, plan)
    with pytest.raises(InputError, match="holds units of another spec"):
        run_made_up(replace(plan, root_seed=1))
    assert (folder / SPEC_FILE).read_text() == spec and rows_of(folder, plan) == before
    with sole_driver(folder), pytest.raises(InputError, match="another run is at work"):
        run_made_up(plan)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    with pytest.raises(InputError, match="already holds files"):
        run_made_up(plan, folder=tmp_path / "other")


def test_units_that_the_code_now_draws_differently_are_refused(run_made_up, tmp_path):
    class Redrawn(MadeUp):
        def unit(self, cell, index):
            return super().unit(cell, index + 100).model_copy(update={"index": index})

    run_made_up(MadeUp({"ok": 2}))
    with pytest.raises(InputError, match="the code now makes ok:0 another unit"):
        run_made_up(Redrawn({"ok": 3}))


def test_a_folder_of_a_driver_killed_at_its_start_is_reused(tmp_path):
    for name in (SPEC_FILE, "driver.lock", "driver.lock-journal", LEDGER_FILE):
        (tmp_path / name).write_text("")
        claim_folder(tmp_path)


@pytest.fixture
def small_disk(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", disk], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("no tmpfs may be mounted here")
    yield disk
    subprocess.run(["umount", disk], check=True)


def test_a_full_disk_ends_the_run_in_one_line_and_the_next_run_resumes(run_made_up, small_disk, tmp_path):
    plan, folder, filler = MadeUp({"ok": 12}), small_disk / "x", small_disk / "filler"

    def fill(tally):
        # Several units may end between two calls.
        if tally.ended_here >= 4 and not filler.exists():
            with pytest.raises(OSError, match="No space left"):
                filler.write_bytes(b"x" * 2**20)

    with pytest.raises(InputError, match="the disk is full; free some space and run the same command again"):
        run_made_up(plan, folder=folder, show=fill)
    filler.unlink()
    kept = rows_of(folder, plan)
    assert 4 <= len(kept) < 12
    assert run_made_up(plan, folder=folder).ended_here == 12 - len(kept)
    assert [row for row in rows_of(folder, plan) if row in kept] == kept


@pytest.fixture
def dask_keys(shared_pool, tmp_path):
    """The keys of the shared cluster, in files that Dask's own configuration names."""
    keys = shared_pool._client.security.get_tls_config_for_role("client")
    names = {"ca_file": "ca-file", "cert": "client.cert", "key": "client.key"}
    for name in names:
        (tmp_path / name).write_text(keys[name])
    return config.set({f"distributed.comm.tls.{of}": str(tmp_path / name) for name, of in names.items()})


def test_a_remote_scheduler_gives_the_same_rows(shared_pool, dask_keys, tmp_path):
    settings = WorkerPoolSettings(scheduler=shared_pool._client.scheduler.address)
    plan = MadeUp({"ok": 5})
    with dask_keys:
        tally = run_experiment(
            plan, tmp_path / "x", lambda: clusters.open_worker_pool(settings, made_up_unit)
        )
    assert tally.done == 5
    assert rows_of(tmp_path / "x", plan) == [decided(made_up_record(plan.unit("ok", i))) for i in range(5)]


def test_the_embedded_cluster_is_reached_with_its_keys_only(shared_pool):
    addresses = [shared_pool._client.scheduler.address, *shared_pool.workers()]
    assert all(address.startswith("tls://127.0.0.1:") for address in addresses)
    for address in addresses:
        for keys, reached in ((None, address.replace("tls:", "tcp:")), (Security.temporary(), address)):
            with pytest.raises(OSError, match=r"reset by peer|certificate|closed"):
                Client(reached, timeout=2, set_as_default=False, security=keys)
    gc.collect()  # as remote_worker_pool does, and for the same reason
    with (
        pytest.raises(InputError, match=r"reached by TLS only .* name its keys in Dask's configuration"),
        clusters.remote_worker_pool(WorkerPoolSettings(scheduler=addresses[0]), made_up_unit),
    ):
        pass


def test_the_keys_of_the_embedded_cluster_are_in_no_file_or_environment(shared_pool):
    folder = shared_pool._reports
    assert not any(b"PRIVATE KEY" in path.read_bytes() for path in folder.rglob("*") if path.is_file())
    for process in psutil.Process().children(recursive=True):
        assert not any("PRIVATE KEY" in part for part in (*process.cmdline(), *process.environ().values()))


def test_nothing_is_served_by_http(shared_pool):
    port = shared_pool._client.cluster.scheduler.http_server.port
    for page in ("", "info/main/workers.html", "json/counts.json", "metrics", "health"):
        with pytest.raises(HTTPError, match="404"):
            urlopen(f"http://127.0.0.1:{port}/{page}", timeout=5)


def test_a_missing_scheduler_is_reported_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(clusters, "_CONNECT_S", 0.3)
    settings = WorkerPoolSettings(scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match=r"tcp://127.0.0.1:9: no scheduler answers .*; start one with"):
        run_experiment(
            MadeUp({"ok": 1}), tmp_path / "x", lambda: clusters.open_worker_pool(settings, made_up_unit)
        )


@pytest.mark.parametrize("address", ["tls://127.0.0.1:9", "nonsense://x"])
def test_no_client_without_a_connection_is_left_to_the_garbage_collector(address):
    gc.collect()
    gc.disable()
    try:
        with (
            pytest.raises(InputError),
            clusters.remote_worker_pool(WorkerPoolSettings(scheduler=address), None),
        ):
            pass
        assert not [one for one in gc.get_objects() if isinstance(one, Client) and one.status == "connecting"]
    finally:
        gc.enable()


def test_all_ports_are_bound_to_loopback(shared_pool):
    me = psutil.Process()
    for process in (me, *me.children(recursive=True)):
        for connection in process.net_connections():
            assert connection.status != "LISTEN" or connection.laddr.ip == "127.0.0.1"


def test_workers_compute_in_one_thread(shared_pool):
    names = list(clusters.SINGLE_THREADED)
    found = shared_pool._client.run(lambda: [os.environ.get(name) for name in names])
    assert all(values == ["1"] * len(names) for values in found.values())
    import cv2

    assert set(shared_pool._client.run(cv2.getNumThreads).values()) == {1}
