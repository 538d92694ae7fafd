"""Figures of two views from tables with known answers."""

import numpy as np
import pandas as pd
import pytest

from dslab.experiments.claims.loading import load_claim
from dslab.experiments.claims.two_view_figures import figures


def rows_of(spec, own):
    """Rows of 40 worlds, four gaps each, in the room; ``own`` gives further columns of world and gap."""
    about = {"scene": "room", "first": 3, "matches": 200, "right": 150, "noise_px": 0.3, "off_plane": 0.1}
    return pd.DataFrame(
        about | {"world": world, "gap": gap, "baseline_m": 0.05 * gap, "parallax_deg": 0.5 * gap} | row
        for world in range(40)
        for gap in (1, 4, 8, 16)
        for row in own(world, gap)
    )


def test_an_error_that_falls_with_the_baseline_has_slope_minus_one_and_its_ratio_to_the_bound():
    spec = load_claim("conditioning")
    names = ("direction_deg", "rotation_deg", "depth")

    def errors(world, gap):
        error = (1 + world / 10) / gap
        estimates = {f"{name}{s}": error for name in names for s in ("", "_refined", "_from_truth")}
        bounds = dict.fromkeys(("bound_direction_deg", "bound_rotation_deg"), error / 3)
        return [estimates | bounds | {"depth_true_pose": error}]

    found = figures(spec, rows_of(spec, errors))
    slope = next(row for row in found["slopes"] if row["over"] == "baseline_m" and row["slope"])
    assert slope["slope"]["value"] == pytest.approx(-1) and slope["worlds"] == 40
    at_4 = next(row for row in found["by_gap"] if row["gap"] == 4)
    assert at_4["direction_deg_of_bound"]["value"] == pytest.approx(3)
    of_worlds = at_4["direction_deg"]
    assert of_worlds["value"] == pytest.approx((1 + 1.95) / 4)
    assert of_worlds["low"] < of_worlds["value"] < of_worlds["high"]
    assert [row["from_deg"] for row in found["by_parallax"]] == [0.25, 1, 2, 4]


def test_only_wrong_winners_with_the_inliers_of_the_truth_are_telling():
    spec = load_claim("ransac-iterations")

    def winners(world, gap):
        wrong = 20.0 if world < 10 else 1.0
        return [
            {
                "samples": samples,
                "inliers": 100 + (world % 2) * 20,
                "inliers_true_pose": 110,
                "confidence": 0.9,
                "direction_deg": wrong * (2 if samples == 50 else 1),
                "rotation_deg": 1.0,
                "depth": 0.1,
            }
            for samples in spec.iterations
        ]

    found = figures(spec, rows_of(spec, winners))
    last = next(row for row in found["by_samples"] if row["samples"] == 50000)
    assert last["off_5"]["value"] == pytest.approx(0.25)
    assert last["telling_5"]["value"] == pytest.approx(0.125)  # of ten worlds that are off, five
    assert last["telling_5"]["low"] < 0.125 < last["telling_5"]["high"]
    change = found["changes"][0]["ratio"]
    assert np.allclose([change[name] for name in ("value", "low", "high")], 0.5)
