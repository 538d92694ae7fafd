"""Self-calibration: a planted residual distortion is found, and none where there is none."""

import numpy as np
import pytest

from dslab.slam.core.camera import NO_RESIDUAL, Residual, distort_residual
from dslab.slam.optimization.lens import LensEstimate, estimate_lens

K = np.array([700.0, 700.0, 600.0, 180.0])
PLANTED = (0.02, -0.006, 0.0005, 0.0015)


def drive(
    seed: int,
    residual: Residual,
    noise_px: float,
    frames: int = 15,
    usual_shift_px: float = np.inf,
    far: float = 0.0,
    readout_s: float | None = None,
) -> LensEstimate:
    """Estimate from a forward drive along a street of points, started beside the truth.

    With ``readout_s``, each view turns at random while its rows are read in that time.
    """
    rng = np.random.default_rng(seed)
    points = np.column_stack(
        [rng.uniform(-12, 12, 900), rng.uniform(-4, 1.6, 900), rng.uniform(4 + far, 60 + far, 900)]
    )
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, 2, 3], T[:, 0, 3] = -0.8 * np.arange(frames), 0.1 * rng.normal(size=frames)
    in_cam = np.einsum("cij,pj->cpi", T[:, :3, :3], points) + T[:, None, :3, 3]
    ideal = in_cam[..., :2] / in_cam[..., 2:] * K[:2] + K[2:]
    seen = (in_cam[..., 2] > 3) & (ideal > 0).all(axis=2) & (ideal < [1200, 360]).all(axis=2)
    camera, point = np.nonzero(seen & (seen.sum(axis=0) >= 3))
    _, point_row = np.unique(point, return_inverse=True)
    pixels = distort_residual(ideal[camera, point], residual, K) + noise_px * rng.normal(
        size=(len(camera), 2)
    )
    rows = None
    if readout_s is not None:
        turn = rng.normal(size=(frames, 2, 1))[camera]
        rows = (pixels[:, 1:] / 360 - 0.5) * np.concatenate([turn[:, 0] * K[0], turn[:, 1] * K[1]], axis=1)
        pixels = pixels + readout_s * rows
    start = points[np.unique(point)] * (1 + 0.01 * rng.normal(size=(len(np.unique(point)), 1)))
    fixed = np.arange(frames) == 0
    weights = np.ones(len(camera))
    return estimate_lens(
        T, fixed, start, camera, point_row, pixels, weights, K, row_shifts=rows, usual_shift_px=usual_shift_px
    )


def test_a_planted_distortion_is_found_exactly_without_noise():
    found = drive(0, PLANTED, 0.0)
    assert found.residual == pytest.approx(PLANTED, abs=1e-4)
    assert found.T_cam_map[-1, 2, 3] / found.T_cam_map[7, 2, 3] == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_distortion_is_significant_where_there_is_one_and_only_there(seed: int):
    found, none = drive(seed, PLANTED, 0.2, 30), drive(seed, NO_RESIDUAL, 0.2, 30)
    assert found.residual == pytest.approx(PLANTED, abs=0.008)
    assert found.significance > 30
    assert none.significance < 18.5


def test_the_usual_shift_bounds_an_estimate_that_says_little_and_leaves_a_sure_one():
    errors = np.array(
        [
            [drive(seed, PLANTED, 1.0, 6, usual, 20.0).residual[0] - PLANTED[0] for usual in (np.inf, 2.0)]
            for seed in range(6)
        ]
    )
    free, held = np.sqrt((errors**2).mean(axis=0))
    assert held < 0.75 * free
    assert drive(0, PLANTED, 0.0, 30, 2.0).residual == pytest.approx(PLANTED, abs=0.003)


def test_a_rolling_shutter_is_found_beside_the_lens():
    rolling = drive(0, PLANTED, 0.2, 30, readout_s=0.02)
    assert rolling.readout_s == pytest.approx(0.02, rel=0.02)
    assert rolling.residual == pytest.approx(PLANTED, abs=0.008)
    assert rolling.readout_significance > 100
    assert drive(0, PLANTED, 0.2, 30, readout_s=0.0).readout_significance < 18.5
