"""Whether a stress acts is known without rendering the sequence; low texture can be made to act."""

import numpy as np
import pytest

from dslab.scenarios.spec import Scenario
from dslab.sim.frame_plan import plan_frames, render_backend
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.stress_check import stress_acts, stress_measure

CAMERA = {"width_px": 128, "height_px": 96, "fx_px": 90, "fy_px": 90, "cx_px": 63.5, "cy_px": 47.5, "fps": 10}


def scenario(world: str = "corridor", **segment) -> Scenario:
    return Scenario.model_validate(
        {
            "name": "looked-at",
            "seed": 5,
            "duration_s": 4,
            "world": {"kind": world, "length_m": 25 if world == "warehouse" else 40},
            "trajectory": {"gaze_deg": 80},
            "camera": CAMERA,
            "segments": [{"start_s": 1.5, "duration_s": 1.0, **segment}],
        }
    )


QUICK = [
    ({"kind": "low_texture", "contrast": 0.1, "view_share": 0.9}, True),
    ({"kind": "motion_blur", "exposure_s": 0.2}, True),
    ({"kind": "fog", "extinction_per_m": 0.02}, False),
]
MORE = [
    ({"kind": "low_texture", "contrast": 0.1, "world": "warehouse"}, None),
    ({"kind": "low_texture", "contrast": 1.0, "view_share": 0.9}, False),
    ({"kind": "motion_blur", "exposure_s": 0.011}, False),
    ({"kind": "fast_rotation", "rate_degps": 150}, True),
    ({"kind": "frame_drops", "share": 0.9}, True),
    ({"kind": "fog", "extinction_per_m": 3.0, "ramp_s": 0.5}, True),
    ({"kind": "flicker", "modulation": 0.9}, True),
]


@pytest.mark.parametrize(
    ("segment", "acts"), QUICK + [pytest.param(*each, marks=pytest.mark.slow) for each in MORE]
)
def test_it_is_what_the_truth_of_the_whole_sequence_says(segment, acts, tmp_path):
    of = scenario(**segment)
    truth = render_sequence(of, cache_dir=tmp_path).segments[0].first_frame >= 0
    assert stress_acts(of) == truth and acts in (truth, None)


def test_a_dose_is_measured_in_the_images_as_the_truth_measures_it(tmp_path):
    name, blur_px = stress_measure(of := scenario(kind="motion_blur", exposure_s=0.2))
    rendered = render_sequence(of, cache_dir=tmp_path)
    within = (rendered.stamps_s >= 1.5) & (rendered.stamps_s < 2.5)
    middle = np.sort(np.flatnonzero(within)[3:7])
    assert name == "blur_px"
    assert blur_px == pytest.approx(np.median(rendered.frame_truth["blur_px"][middle]), rel=0.2)
    assert stress_measure(scenario(kind="time_jitter", sigma_s=0.02))[0] == "stamp_error_s"


@pytest.mark.parametrize("world", ["corridor", "warehouse"])
@pytest.mark.slow
def test_the_asked_share_of_the_view_fades_from_surfaces_that_are_seen_least_elsewhere(world):
    def plan(**segment):
        of = scenario(world, kind="low_texture", contrast=0.1, **segment)
        made, _ = plan_frames(of, render_backend())
        seen, faded = made.view_share, made.contrast < 1
        within = made.within(of.segments[0])
        return seen[within][:, faded].sum(axis=1).mean(), seen[~within][:, faded].sum(axis=1).mean(), faded

    half, whole = plan(view_share=0.5), plan(view_share=1.0)
    assert half[0] >= 0.5 and whole[0] > 0.95 and half[1] < whole[1]
    assert np.all(whole[2][half[2]]) and half[2].sum() < whole[2].sum()
