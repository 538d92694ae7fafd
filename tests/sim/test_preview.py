"""A preview's frames are those of the whole sequence."""

import numpy as np
import pytest

from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.registry import DEGRADATIONS, FRAME_PLAN_KINDS, IMAGE_KINDS
from dslab.sim.preview import preview
from dslab.sim.sequence_rendering import render_sequence

CAMERA = {"width_px": 128, "height_px": 96, "fx_px": 90, "fy_px": 90, "cx_px": 63.5, "cy_px": 47.5, "fps": 10}
SEGMENT_S, EVERY_S = 0.7, 0.9


def with_segments(kinds: list[str], camera: dict) -> Scenario:
    """One segment of every kind with a drawn severity, with clean time between them."""
    rng = np.random.default_rng(3)
    segments = [
        {
            "kind": kind,
            "start_s": round(0.5 + EVERY_S * k, 3),
            "duration_s": SEGMENT_S,
            **DEGRADATIONS[kind].sample(rng),
            **({"ramp_s": 0.2} if kind in IMAGE_KINDS else {}),
        }
        for k, kind in enumerate(kinds)
    ]
    return Scenario.model_validate(
        {
            "name": "previewed",
            "seed": 5,
            "duration_s": EVERY_S * len(kinds) + 1,
            "world": {"kind": "corridor", "length_m": 10, "turns": 0},
            "trajectory": {"gaze_deg": 90},
            "camera": camera,
            "segments": segments,
        }
    )


@pytest.mark.parametrize(
    ("kinds", "camera"),
    [
        (list(DEGRADATIONS), {**CAMERA, "distortion": {"model": "radtan", "k1": -0.05}}),
        (list(FRAME_PLAN_KINDS), CAMERA),
    ],
    ids=["every kind, a distorting lens", "no kind on images"],
)
@pytest.mark.slow
def test_some_frames_are_those_of_the_whole_sequence(kinds, camera, tmp_path):
    scenario = with_segments(kinds, camera)
    whole = render_sequence(scenario, cache_dir=tmp_path)
    look = preview(scenario)
    # Every third frame: no frame follows its neighbour, and every segment has some.
    indices = list(range(1, len(look.plan.stamps_s), 3))
    assert all(look.plan.within(segment)[indices].any() for segment in scenario.segments)
    images, blur_px, _ = look.expose_frames(indices)
    assert len(whole) == len(look.plan.stamps_s)
    for index, image in zip(indices, images, strict=True):
        assert np.array_equal(image, whole.frames[index]), f"frame {index}"
    np.testing.assert_array_equal(blur_px, whole.frame_truth["blur_px"][indices])
