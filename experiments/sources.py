"""A sequence from what a user names: a folder, a scenario, or a scenario file."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from scenarios.errors import InputError
from sim.imu import ImuReadings, ImuTruth
from sim.sequence import Sequence

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, frames done and frames in all."""


def open_sequence(source: str, seed: int | None = None, progress: Progress | None = None) -> Sequence:
    """Load a sequence folder, or render a scenario (or take it from the cache).

    Args:
        source: a folder in TUM, KITTI, EuRoC or TUM-mono form, the name of a scenario, or the path of its
            YAML file.
        seed: root seed of a scenario, with which it is drawn too; its own where None; a folder has none.
        progress: called with (step, frames done, frames in all) while rendering.

    Raises:
        InputError: there is no such thing, or it is not valid.
    """
    path = Path(source)
    if path.is_dir():
        from sim.io.forms import load_sequence

        return load_sequence(path)
    from scenarios.families import is_scenario_name
    from scenarios.loading import load_scenario

    if not path.exists() and len(path.parts) > 1 and not is_scenario_name(source):
        raise InputError(
            source, "no such folder", "check the path, or name a scenario (dslab scenarios list)"
        )
    from sim.render import render_sequence

    return render_sequence(load_scenario(source, seed), progress=progress)


def record_scenario_imu(
    source: str, stamps_s: np.ndarray, seed: int | None = None, progress: Progress | None = None
) -> tuple[ImuReadings, ImuTruth]:
    """Inertial readings along a scenario's motion, and the truth at its frames.

    Args:
        source: the name of a scenario, or the path of its YAML file.
        stamps_s: (N,) stamps of its frames.
        seed: root seed, the scenario's own where None.
        progress: called with (step, frames done, frames in all).

    Raises:
        InputError: it is a folder, which has no continuous motion, or no valid scenario.
    """
    if Path(source).is_dir():
        raise InputError(
            f"--imu: {source}", "a folder has no continuous motion", "name a scenario, or leave out --imu"
        )
    from scenarios.loading import load_scenario
    from sim.imu import record_imu
    from sim.render import mujoco_studio, plan_shoot

    scenario = load_scenario(source, seed)
    told = progress or (lambda step, done, total: None)
    shoot, _ = plan_shoot(scenario, scenario.seed, mujoco_studio(), told)
    return record_imu(shoot.motion, stamps_s, scenario.seed)
