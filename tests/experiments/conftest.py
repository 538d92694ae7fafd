"""Runs of synthetic units in this process; runs without pictures."""

from contextlib import nullcontext
from functools import partial

import pytest
from pool_fakes import LocalPool
from unit_fakes import made_up_unit

from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.jobs.pool import open_pool


@pytest.fixture
def no_picture(monkeypatch):
    """Runs write an empty trajectory.png, as drawing takes a third of a second."""
    monkeypatch.setattr(
        "dslab.experiments.pictures.run_picture.draw_runs", lambda path, records: path.touch()
    )


@pytest.fixture
def run_made_up(tmp_path):
    """A function that runs a synthetic experiment in a folder: in this process, or on workers of settings."""

    def run(plan, folder=tmp_path / "x", workers=None, job=made_up_unit, **options):
        tries = tmp_path / "tries"
        tries.mkdir(exist_ok=True)
        task = partial(job, cache_dir=tries)

        def opened():
            return nullcontext(LocalPool(task)) if workers is None else open_pool(task, workers)

        return run_experiment(plan, folder, opened, **options)

    return run
