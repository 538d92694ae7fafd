"""The Python interface: one function per task, and imports that cost nothing."""

import inspect
import subprocess
import sys

import numpy as np
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab import experiments, scenarios, sim, slam
from dslab.experiments.cli.run import run_command
from dslab.experiments.runs.execution import system_factory
from dslab.experiments.runs.slam_settings import SlamSettings, factory_of
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


def test_python_and_the_command_line_have_the_same_defaults():
    python, command = (inspect.signature(of).parameters for of in (experiments.run, run_command))
    for name in ("system", "mode", "seed"):
        assert python[name].default == command[name].default, name
    camera = slam.PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0)
    for system in ("base", "dual"):
        made = [build(system, camera, 0).settings for build in (system_factory(), factory_of(SlamSettings()))]
        assert made[0] == made[1]


@pytest.mark.slow
def test_many_runs_are_those_that_come_one_by_one(tmp_path):
    scenario = scenarios.Scenario.model_validate(
        scenarios.load("small/room", seed=4).model_dump() | {"duration_s": 3.0}
    )
    arguments = [{"sequence": scenario, "system": system, "seed": 2} for system in ("dual", "base")]
    told = []
    many = experiments.run_many(arguments, workers=2, progress=lambda *done: told.append(done))
    assert [one.system for one in many] == ["dual", "base"] and told == [(1, 2), (2, 2)]
    alone = experiments.run(scenario, "base", seed=2)
    assert alone.trajectory is not None and many[1].trajectory is not None
    np.testing.assert_array_equal(many[1].trajectory.T_map_cam, alone.trajectory.T_map_cam)
    assert many[1].metrics["ate_m"] == alone.metrics["ate_m"]
    np.testing.assert_array_equal(many[1].sequence.frames[40], alone.sequence.frames[40])
    many[0].plot(tmp_path / "run.png")


def test_many_runs_take_no_frames_in_memory(sequence):
    with pytest.raises(InputError, match=r"runs\[1\]: its sequence is frames in memory"):
        experiments.run_many([{"sequence": "small/room"}, {"sequence": sequence}])
