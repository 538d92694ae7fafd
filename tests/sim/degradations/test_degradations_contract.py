"""Promises of every kind of degradation, checked on rendered worlds."""

from functools import partial

import numpy as np
import pytest
from degradation_worlds import (
    DURATION_S,
    SEVERITIES,
    START_S,
    WORLDS,
    digest,
    mean_inliers,
    segment,
    small_backend,
    small_scenario,
)
from scipy.stats import spearmanr

from dslab.sim.degradations.registry import DEGRADATIONS, IMAGE_KINDS
from dslab.sim.frame_plan import camera_intrinsics, plan_frames
from dslab.sim.sensors.distortion import Lens
from dslab.sim.sensors.tone import map_light
from dslab.sim.sequence_rendering import render_sequence

SEED = 4
# Kinds that draw random numbers.
RANDOM = {"low_light", "moving_objects", "lens_dirt", "rain", "frame_drops", "time_jitter"} | {
    *("lens_flare", "cracked_lens", "flicker", "day_to_night", "bandwidth_loss")
}
# Every kind is rendered in one world, and every world with some kinds.
WORLD_OF = {kind: list(WORLDS)[k % len(WORLDS)] for k, kind in enumerate(DEGRADATIONS)}


@pytest.fixture(scope="module")
def render(tmp_path_factory):
    cache = tmp_path_factory.mktemp("cache")

    def render(world, *segments, seed=SEED, cache_dir=None, **more):
        scenario = small_scenario(world, *segments, **more)
        return render_sequence(
            scenario, seed, cache_dir=cache_dir or cache, depth=True, backend=small_backend()
        )

    return render


def inliers(sequence, clean, kind) -> float:
    # Two frames with the same distortion match each other: a rolling shutter shows against clean frames.
    return mean_inliers(sequence, clean if kind == "rolling_shutter" else None)


def test_every_kind_has_severities_to_be_tested_with():
    assert set(SEVERITIES) == set(DEGRADATIONS)


@pytest.mark.parametrize("kind", DEGRADATIONS)
def test_a_harmless_severity_changes_nothing_and_a_fatal_one_costs_matches(render, kind):
    clean = render("corridor")
    harmless, fatal = (render("corridor", segment(kind, **SEVERITIES[kind][k])) for k in (0, -1))
    assert digest(harmless) == digest(clean)
    assert harmless.segments[0].first_frame == -1
    assert inliers(fatal, clean, kind) < 0.7 * inliers(clean, clean, kind)


@pytest.mark.slow
@pytest.mark.parametrize("kind", DEGRADATIONS)
def test_matches_get_fewer_with_severity(render, kind):
    world = WORLD_OF[kind]
    clean = render(world)
    sequences = [render(world, segment(kind, **severity)) for severity in SEVERITIES[kind]]
    counts = np.array([inliers(sequence, clean, kind) for sequence in sequences])
    assert spearmanr(range(5), counts).statistic <= -0.8, counts
    assert counts[-1] < 0.7 * counts[0], counts


@pytest.mark.parametrize("kind", sorted(RANDOM))
def test_the_same_seed_gives_the_same_bytes_and_another_stream_others(render, kind, tmp_path):
    worst = segment(kind, **SEVERITIES[kind][3])
    first = render("corridor", worst)
    assert digest(render("corridor", worst, cache_dir=tmp_path)) == digest(first)
    # In the same clean sequence, a segment that starts 1 ms earlier draws other numbers.
    moved = render("corridor", {**worst, "start_s": START_S - 1e-3})
    assert digest(moved) != digest(first)


@pytest.mark.parametrize("kind", DEGRADATIONS)
def test_the_truth_names_the_frames_on_which_it_acts(render, kind):
    clean = render("corridor")
    sequence = render("corridor", segment(kind, **SEVERITIES[kind][4]))
    truth = sequence.segments[0]
    assert truth.kind == kind
    assert 0 <= truth.first_frame <= truth.last_frame < len(sequence)
    measure = sequence.frame_truth[truth.measure]
    assert measure.shape == (len(sequence),)
    assert measure[truth.first_frame] >= truth.threshold
    if kind in IMAGE_KINDS:
        inside = (sequence.stamps_s >= START_S - 1e-9) & (sequence.stamps_s < START_S + DURATION_S - 1e-9)
        changed = [not np.array_equal(a, b) for a, b in zip(sequence.frames, clean.frames, strict=True)]
        np.testing.assert_array_equal(changed, inside)
        np.testing.assert_array_equal(measure > 0, inside)


@pytest.mark.parametrize("kind", IMAGE_KINDS)
@pytest.mark.slow
def test_a_ramp_rises_and_falls_and_a_segment_may_follow_at_once(render, kind):
    severity = SEVERITIES[kind][4]
    ramped = {"kind": kind, "start_s": 0.2, "duration_s": 0.4, "ramp_s": 0.2, **severity}
    sequence = render("corridor", ramped, {"kind": kind, "start_s": 0.6, "duration_s": 0.2, **severity})
    measure = sequence.frame_truth[sequence.segments[0].measure]
    assert measure[4] == 0 and (measure[[5, 11]] < measure[8]).all()
    assert measure[8] == pytest.approx(measure[12], rel=0.5)
    first, second = sequence.segments
    assert 4 < first.first_frame <= 8 <= first.last_frame < 12
    assert (second.first_frame, second.last_frame) == (12, 15)


def test_a_distorting_lens_acts_after_the_light_s_way_to_it(render):
    camera = {
        **small_scenario("corridor").camera.model_dump(),
        "noise_sigma": 0,
        "exposure_s": 0,
        "distortion": {"model": "radtan", "k1": -0.2, "k2": 0.03},
    }
    sequence = render("corridor", segment("over_exposure", stops=1), camera=camera)
    scenario, backend = small_scenario("corridor", camera=camera, seed=SEED), small_backend()
    plan, world = plan_frames(scenario, backend)
    lens = Lens(camera_intrinsics(scenario.camera))
    renderer = backend.renderer(world, lens.ideal)
    for frame, stops in ((2, 0), (6, 1)):
        sharp, ideal_m = renderer.render(plan.motion.T_world_cam(plan.stamps_s[frame]))
        gray, depth_m = lens.distort(sharp), lens.distort_depth(ideal_m)
        np.testing.assert_array_equal(sequence.depths[frame], depth_m)
        expected = map_light(gray, partial(np.multiply, 2.0**stops))
        np.testing.assert_array_equal(sequence.frames[frame], expected)
    assert sequence.frames[2].shape == (180, 240)


def test_a_second_severity_renders_nothing_again(tmp_path):
    steps: list[str] = []
    for transmission in (0.5, 0.1):
        steps.clear()
        render_sequence(
            small_scenario("corridor", segment("covered_lens", transmission=transmission)),
            SEED,
            cache_dir=tmp_path,
            backend=small_backend(),
            progress=lambda step, done, total: steps.append(step),
        )
    assert "rendering" not in steps and len(steps) == 16
