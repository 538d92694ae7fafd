"""Overlapping segments: order of declaration and the truth of each."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from degradation_worlds import SEVERITIES, digest, small_backend, small_scenario
from io_sequences import PINHOLE, Stack, make_sequence

from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.recorded_sequences import degrade_sequence
from dslab.sim.degradations.registry import FRAME_PLAN_KINDS, IMAGE_KINDS, in_order_of_action
from dslab.sim.degradations.segment_link import SegmentLink, segment_links
from dslab.sim.io.forms import Form, load_sequence, write_sequence
from dslab.sim.link import View, fold
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import SegmentTruth
from dslab.sim.sequence_rendering import render_sequence

CAMERA = Intrinsics(160, 120, 120.0, 120.0, 79.5, 59.5, 30.0)


def declared(kind: str, start_s: float, duration_s: float, level: int = 2) -> dict:
    return {"kind": kind, "start_s": start_s, "duration_s": duration_s, **SEVERITIES[kind][level]}


MIXED = [
    declared("fast_rotation", 0.45, 0.3),
    declared("pure_rotation", 0.1, 0.3, 1),
    declared("low_texture", 0.2, 0.5),
    declared("motion_blur", 0.3, 0.3),
    declared("time_jitter", 0.2, 0.4),
    declared("frame_drops", 0.2, 0.4, 1),
    declared("fog", 0.2, 0.3),
    declared("rain", 0.2, 0.4),
    declared("moving_objects", 0.25, 0.4, 1),
    declared("low_light", 0.3, 0.3),
    declared("over_exposure", 0.35, 0.2, 1),
    declared("jpeg", 0.2, 0.3),
    declared("jpeg", 0.5, 0.2, 3),
]


@pytest.fixture(scope="module")
def render(tmp_path_factory):
    def render(segments):
        cache = tmp_path_factory.mktemp("cache")
        scenario = small_scenario("corridor", *segments)
        return render_sequence(scenario, 4, cache_dir=cache, backend=small_backend())

    return render


def test_the_order_of_declaration_changes_nothing(render):
    first = render(MIXED)
    other = render(MIXED[::-1])
    assert digest(other) == digest(first)
    assert other.segments == first.segments
    assert list(other.frame_truth) == list(first.frame_truth)
    for name, values in first.frame_truth.items():
        np.testing.assert_array_equal(other.frame_truth[name], values)
    assert [s.start_s for s in first.segments] == sorted(s["start_s"] for s in MIXED)


def test_the_truth_of_segments_that_start_together_is_that_of_each_alone(render):
    kinds = ("fog", "jpeg", "fast_rotation")
    together = [declared(kind, 0.2, 0.2 + 0.1 * i) for i, kind in enumerate(kinds)]
    composed = render(together)
    by_kind = {truth.kind: truth for truth in composed.segments}
    assert set(by_kind) == set(kinds)
    for segment in together:
        alone = render([segment])
        assert by_kind[segment["kind"]] == alone.segments[0]
        mask = by_kind[segment["kind"]].mask(len(composed))
        if segment["kind"] in IMAGE_KINDS:
            inside = np.abs(composed.stamps_s - 0.2 - segment["duration_s"] / 2 + 1e-6)
            np.testing.assert_array_equal(mask, inside < segment["duration_s"] / 2)
    # The swing rests at its turning point.
    swing = by_kind["fast_rotation"]
    assert len(swing.runs) == 2 and swing.mask(16).sum() < swing.last_frame - swing.first_frame + 1


def test_overlapping_segments_survive_writing_and_reading(tmp_path):
    composed = (
        SegmentTruth("fog", {"extinction_per_m": 1.0}, 0.2, 0.6, 1, 4, "fog_veil", 0.5),
        SegmentTruth("jpeg", {"quality": 5.0}, 0.2, 0.5, 1, 5, "jpeg_loss", 50.0, ((1, 2), (4, 5))),
    )
    sequence = replace(make_sequence(), camera=PINHOLE, segments=composed)
    for form in (Form.TUM, Form.KITTI, Form.EUROC):
        write_sequence(sequence, tmp_path / form, form)
        read = load_sequence(tmp_path / form)
        assert read.segments == composed
        for a, b in zip(read.segments, composed, strict=True):
            np.testing.assert_array_equal(a.mask(6), b.mask(6))


def chain_input() -> tuple[Stack, np.ndarray, np.ndarray, PoseSpline]:
    rng = np.random.default_rng(5)
    images = Stack(rng.integers(0, 256, (12, 120, 160), dtype=np.uint8))
    knots = np.arange(-1, 3, 0.1)
    walk = PoseSpline(knots, np.outer(knots, [0.5, 0.1, 0]), np.outer(knots, [0.1, 0, 0.2]))
    return images, np.full((120, 160), 3.0, np.float32), np.arange(12) / 10, walk


def test_the_segments_act_one_after_the_other_in_their_order():
    images, depth_m, stamps_s, walk = chain_input()
    segments = [
        SEGMENT_KINDS[kind](**declared(kind, 0.1 + 0.03 * i, 0.7), ramp_s=0.1)
        for i, kind in enumerate(reversed(IMAGE_KINDS))
    ]
    whole = segment_links(segments, CAMERA, stamps_s, 7)
    parts = [SegmentLink(s, CAMERA, stamps_s, 7) for s in in_order_of_action(segments)]
    assert all(a.kind.stage <= b.kind.stage for a, b in pairwise(whole))
    for index, image in enumerate(images):
        view = View(index, float(stamps_s[index]), depth_m=depth_m, motion=walk, index=index)
        expected = image
        for part in parts:
            expected, _ = part.apply(expected, view)
        np.testing.assert_array_equal(fold(whole, image, view)[0], expected)
    for link, part in zip(whole, parts, strict=True):
        assert link.segment == part.segment
        np.testing.assert_array_equal(link.measure, part.measure)


def test_degrading_a_recorded_sequence_twice_is_degrading_it_at_once(tmp_path):
    images, _, stamps_s, _ = chain_input()
    sequence = replace(
        make_sequence(),
        camera=CAMERA,
        stamps_s=stamps_s + 1e3,
        frames=images,
        T_world_cam=None,
        depths=None,
        segments=(),
        frame_truth={},
    )
    drops = SEGMENT_KINDS["moving_objects"](**declared("moving_objects", 0.2, 0.6))
    dark = SEGMENT_KINDS["low_light"](**declared("low_light", 0.2, 0.4))
    folders = [tmp_path / name for name in ("once", "first", "second")]
    for folder in folders:
        folder.mkdir()
    once = degrade_sequence(sequence, [dark, drops], 3, folders[0])
    first = degrade_sequence(sequence, [drops], 3, folders[1])
    second = degrade_sequence(first, [dark], 3, folders[2])
    for a, b in zip(once.frames, second.frames, strict=True):
        np.testing.assert_array_equal(a, b)
    assert sorted(once.segments, key=lambda s: s.kind) == sorted(second.segments, key=lambda s: s.kind)
    for name, values in once.frame_truth.items():
        np.testing.assert_array_equal(second.frame_truth[name], values)


def walk_past_walls(**more) -> FramePlan:
    """A plan with ten surfaces, each of which fills the view for a second."""
    stamps_s = np.arange(300) / 30
    share = np.maximum(0, 1 - np.abs(stamps_s[:, None] - (np.arange(10) + 0.5)))
    walk = chain_input()[3]
    return FramePlan(stamps_s, walk, np.full(300, 0.004), np.ones(10), share.astype(np.float32), **more)


def test_a_stop_before_a_swing_does_not_move_the_swing():
    stop = SEGMENT_KINDS["pure_rotation"](**declared("pure_rotation", 0.2, 0.5))
    swing = SEGMENT_KINDS["fast_rotation"](**declared("fast_rotation", 1.0, 0.5))
    plan = walk_past_walls()
    for segment in in_order_of_action([swing, stop]):
        plan = FRAME_PLAN_KINDS[segment.kind].apply(plan, segment)
    at_s = np.linspace(0.9, 1.6, 50)
    without = FRAME_PLAN_KINDS["pure_rotation"].apply(walk_past_walls(), stop).motion.T_world_cam(at_s)
    turned = np.abs(plan.motion.T_world_cam(at_s) - without).max(axis=(1, 2)) > 1e-9
    np.testing.assert_array_equal(turned, (at_s > 1.0) & (at_s < 1.5))


def test_dropped_frames_do_not_change_which_surfaces_fade():
    faded = SEGMENT_KINDS["low_texture"](kind="low_texture", start_s=4, duration_s=2, contrast=0.1)
    drops = SEGMENT_KINDS["frame_drops"](kind="frame_drops", start_s=3, duration_s=4, share=0.9)
    kind = FRAME_PLAN_KINDS["low_texture"]
    plan = kind.apply(walk_past_walls(), faded)
    whole = kind.measure(plan, faded, np.zeros(300))
    fewer = FRAME_PLAN_KINDS["frame_drops"].apply(plan, drops)
    part = kind.measure(fewer, faded, np.zeros(len(fewer.frame)))
    np.testing.assert_array_equal(part, whole[fewer.frame])
