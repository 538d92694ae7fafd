"""Losses of systems that declare none."""

import numpy as np
from odometry_scripts import walk
from scipy.spatial.transform import Rotation

from dslab.slam.framework.watcher import Watcher


def suspicions(poses) -> list[str]:
    watcher = Watcher()
    return [watcher.suspicion(T) for T in poses]


def test_a_jump_beyond_all_steps_is_suspected_and_a_start_or_a_stop_is_not():
    calm = walk(100)
    calm[:, :3, 3] += np.random.default_rng(0).normal(0, 0.003, (100, 3))
    stops = np.concatenate([calm, np.tile(calm[-1], (20, 1, 1))])
    jumps, turns = calm.copy(), calm.copy()
    jumps[80:, :3, 3] += [0, 0, 1.0]
    turns[80:, :3, :3] = Rotation.from_rotvec([0, 0.8, 0]).as_matrix() @ turns[80:, :3, :3]
    assert not any(suspicions(stops))
    assert next(k for k, said in enumerate(suspicions(jumps)) if said) == 80
    assert next(k for k, said in enumerate(suspicions(turns)) if said) == 80


def test_one_frame_in_ten_thousand_is_suspected_though_tails_are_heavy():
    """Student's t of 3 degrees of freedom: tails fall with the cube, steps deviate by tens of deviations."""
    rng, frames, said = np.random.default_rng(3), 400, 0
    for _ in range(50):
        T = np.tile(np.eye(4), (frames, 1, 1))
        T[:, :3, 3] = np.cumsum(0.1 + 0.01 * rng.standard_t(3, (frames, 3)), axis=0)
        said += sum(map(bool, suspicions(T)))
    assert said <= 6  # of 20,000; 2 are expected at most
