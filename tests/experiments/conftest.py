"""One embedded cluster for all tests, because it takes seconds to start; runs without pictures."""

from contextlib import nullcontext
from functools import partial

import pytest
from unit_fakes import made_up_unit

from dslab.experiments.campaign.clusters import embedded_worker_pool
from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.campaign.unit_job import unit_record
from dslab.experiments.campaign.worker_pool import WorkerPool, WorkerPoolSettings


@pytest.fixture(scope="session")
def shared_pool():
    """Two workers with 600 MiB each."""
    with embedded_worker_pool(WorkerPoolSettings(workers=2, memory_mb=600), made_up_unit) as pool:
        yield pool


@pytest.fixture
def no_picture(monkeypatch):
    """Runs write an empty trajectory.png, as drawing takes a third of a second."""
    monkeypatch.setattr(
        "dslab.experiments.pictures.run_picture.draw_runs", lambda path, records: path.touch()
    )


@pytest.fixture
def run_made_up(shared_pool, tmp_path):
    """A function that runs a synthetic experiment in a folder on the shared workers."""

    def run(plan, folder=tmp_path / "x", timeout_s=60.0, job=made_up_unit, **options):
        tries = tmp_path / "tries"
        tries.mkdir(exist_ok=True)
        settings = WorkerPoolSettings(workers=2, timeout_s=timeout_s, memory_mb=600)
        task = partial(unit_record, job, cache_dir=tries)
        pool = WorkerPool(shared_pool._client, task, settings, tmp_path)
        return run_experiment(plan, folder, lambda: nullcontext(pool), **options)

    return run
