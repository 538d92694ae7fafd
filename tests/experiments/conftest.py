"""One embedded cluster for all tests of runs: it takes seconds to start."""

from contextlib import nullcontext

import pytest
from unit_fakes import made_up_unit

from experiments.campaign.runner import run_experiment
from experiments.campaign.worker_pool import Crew, CrewSettings, embedded_crew


@pytest.fixture(scope="session")
def shared_crew():
    """Two workers with 600 MiB each."""
    with embedded_crew(CrewSettings(workers=2, memory_mb=600), made_up_unit) as crew:
        yield crew


@pytest.fixture
def run_made_up(shared_crew, tmp_path):
    """Runs a made-up experiment in a folder on the shared workers."""

    def run(plan, folder=tmp_path / "x", timeout_s=60.0, job=made_up_unit, **options):
        tries = tmp_path / "tries"
        tries.mkdir(exist_ok=True)
        settings = CrewSettings(workers=2, timeout_s=timeout_s, memory_mb=600, cache_dir=tries)
        crew = Crew(shared_crew._client, job, settings, tmp_path)
        return run_experiment(plan, folder, lambda: nullcontext(crew), **options)

    return run
