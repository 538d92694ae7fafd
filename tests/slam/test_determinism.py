"""Rendered scenarios, run twice in lockstep: the same bits, in this process and in another on one core."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from slam_scenes import feed, fingerprint, kinds

from scenarios.loading import load_scenario
from sim.render import render_sequence
from slam.camera import PinholeCamera
from slam.factory import build_system

REPOSITORY = Path(__file__).parents[2]
# Scenario, seed, seconds of it, and what happens there.
RUNS = [
    ("clean-room", 0, 6.0, ["initialized"]),
    ("covered-lens", 2, 29.0, ["initialized", "loop_closed", "map_adjusted", "breakage", "relocalized"]),
    ("loop/city", 1, 45.0, ["initialized", "loop_closed", "map_adjusted"]),
]


def digest_of_scenario(name, seed, duration_s):
    """What the base makes of a scenario: its fingerprint and the kinds of its events, as one line."""
    scenario = load_scenario(name, seed)
    sequence = render_sequence(
        scenario.model_copy(update={"duration_s": min(duration_s, scenario.duration_s)})
    )
    c = sequence.camera
    camera = PinholeCamera(c.width_px, c.height_px, c.fx, c.fy, c.cx, c.cy, c.fps)
    system = build_system("base", camera, 0)
    feed(system, (sequence.frames[i] for i in range(len(sequence))), sequence.stamps_s, check=False)
    return " ".join([fingerprint(system), *kinds(system)])


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no processor affinity here")
@pytest.mark.parametrize(("name", "seed", "duration_s", "happens"), RUNS, ids=[run[0] for run in RUNS])
def test_a_scenario_gives_the_same_run_twice_and_on_one_core(name, seed, duration_s, happens):
    here = digest_of_scenario(name, seed, duration_s)
    assert set(happens) <= set(here.split()[1:])
    script = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from test_determinism import digest_of_scenario\n"
        f"print(digest_of_scenario({name!r}, {seed}, {duration_s}))"
    )
    path = os.pathsep.join([str(REPOSITORY), str(Path(__file__).parent)])
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, "-c", script]
    child = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert child.returncode == 0, child.stderr
    assert child.stdout.strip() == here
