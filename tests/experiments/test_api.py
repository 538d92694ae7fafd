"""The Python interface: one function per task, and imports that cost nothing."""

import subprocess
import sys

import numpy as np
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab import experiments, scenarios, sim, slam
from dslab.scenarios.errors import InputError


@pytest.fixture(scope="module")
def sequence():
    return make_sequence()


@pytest.fixture(scope="module")
def run(sequence):
    return experiments.run(sequence, fake_factory(sequence, breaks_at=160, recovers=False), seed=3)


@pytest.mark.parametrize("package", [scenarios, sim, slam, experiments])
def test_every_promised_name_is_there_and_documented(package):
    for name in package.__all__:
        promised = getattr(package, name)
        assert promised.__doc__ or not callable(promised), name
    assert set(package.__all__) <= set(dir(package))
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # noqa: B018


def test_importing_the_packages_loads_no_gl_and_no_compiler():
    code = (
        "import sys, scenarios, sim, slam, experiments\n"
        "print({'numba', 'mujoco', 'OpenGL', 'rerun', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_run_has_trajectory_events_metrics_and_a_plot(run, sequence, tmp_path):
    assert run.trajectory is run.trajectories[0] and len(run.trajectories) == 2
    assert [e.frame for e in run.events if isinstance(e, slam.events.Breakage)] == [160]
    assert run.metrics["breakages"] == 1 and run.metrics["ate_m"] == pytest.approx(0, abs=1e-6)
    figure = run.plot(tmp_path / "run.png")
    assert figure.axes and (tmp_path / "run.png").stat().st_size > 10_000
    run.save(tmp_path / "saved")
    assert (tmp_path / "saved" / "trajectory_map1.txt").is_file()
    with pytest.raises(InputError):
        run.save(tmp_path / "saved")


def test_runs_are_compared_in_a_table(run, sequence):
    other = experiments.run(sequence, fake_factory(sequence))
    table = experiments.compare([run, other])
    assert list(table["breakages"]) == [1, 0]
    assert table["share_tracked"].iloc[1] > table["share_tracked"].iloc[0]
    assert table["ate_m"].dtype == np.float64


def test_an_unknown_system_is_bad_input(sequence):
    with pytest.raises(InputError, match="one of base, dual"):
        experiments.run(sequence, "dualslam")
