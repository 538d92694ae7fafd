"""Known answers of the kinds that act on the lens, the light and the coded video."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from degradation_worlds import SEVERITIES

from dslab.scenarios.segment_text import parse_segment
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.sim.degradations.base import streams_of
from dslab.sim.degradations.image import View
from dslab.sim.degradations.recorded_sequences import degrade_sequence
from dslab.sim.degradations.registry import IMAGE_KINDS
from dslab.sim.degradations.retake import fill_narrow_holes
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode
from dslab.sim.sequence import Sequence

CAMERA = Intrinsics(160, 120, 120.0, 120.0, 79.5, 59.5, 30.0)
KINDS = (
    "shallow_focus",
    "lens_flare",
    "cracked_lens",
    "vignetting",
    "flicker",
    "day_to_night",
    "bandwidth_loss",
)
RNG = np.random.default_rng(3)
IMAGE = cv2.GaussianBlur(RNG.integers(0, 256, (120, 160), dtype=np.uint8), (0, 0), 1.2)
GRAY = np.full((120, 160), 150, np.uint8)
SLOPE_M = np.tile(np.linspace(0.5, 4, 160, dtype=np.float32), (120, 1))


def make(kind: str, seed: int = 0, **severity):
    segment = SEGMENT_KINDS[kind](kind=kind, start_s=1, duration_s=2, **severity)
    return IMAGE_KINDS[kind].prepare(segment, CAMERA, partial(streams_of, seed, segment))


def at(frame: int = 0, strength: float = 1.0, stamp_s: float = 1.2, motion=None, depth_m=SLOPE_M) -> View:
    return View(frame, stamp_s, strength, depth_m, motion)


@pytest.mark.parametrize("kind", KINDS)
def test_no_dose_changes_nothing_and_a_larger_one_changes_more(kind):
    doses = [make(kind, **severity) for severity in SEVERITIES[kind]]
    changes, measures = [], []
    for dose in doses:
        runs = [dose(IMAGE, at(frame)) for frame in range(4)]
        changes.append(np.mean([np.abs(out.astype(int) - IMAGE).mean() for out, _ in runs]))
        measures.append(np.mean([measure for _, measure in runs]))
    assert changes[0] == measures[0] == 0
    assert (np.diff(changes) > 0).all() and (np.diff(measures) > 0).all(), (changes, measures)


@pytest.mark.parametrize("kind", KINDS)
def test_half_of_a_ramp_is_half_of_the_dose(kind):
    field = next(iter(SEVERITIES[kind][-1]))
    severity = SEVERITIES[kind][2]
    half = make(kind, **{**severity, field: severity[field] / 2})(IMAGE, at())
    ramped = make(kind, **severity)(IMAGE, at(strength=0.5))
    np.testing.assert_array_equal(half[0], ramped[0])
    assert half[1] == pytest.approx(ramped[1])


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in ("shallow_focus", "vignetting")])
def test_the_seed_decides_what_is_drawn(kind):
    first, same, other = (make(kind, seed, **SEVERITIES[kind][2])(IMAGE, at())[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)


def test_a_corner_loses_the_stops_and_the_middle_nothing():
    out, stops = make("vignetting", stops=2)(GRAY, at())
    light = decode(out) / decode(GRAY)
    assert stops == 2 and light[60, 80] == pytest.approx(1, rel=0.02)
    assert light[0, 0] == pytest.approx(0.25, rel=0.02)
    assert light[60, 0] == pytest.approx(2 ** (-2 * 0.64), rel=0.02)


def test_flicker_bands_follow_the_mains_over_rows_and_frames():
    flicker = make("flicker", modulation=0.3, rate_hz=100, readout_s=0.02)
    rows = decode(flicker(GRAY, at())[0])[:, 0] / decode(GRAY)[0, 0]
    assert rows.max() == pytest.approx(1.3, abs=0.02) and rows.min() == pytest.approx(0.7, abs=0.02)
    np.testing.assert_allclose(rows[:60], rows[60:], atol=0.02)  # a period is half of the readout
    np.testing.assert_allclose(
        rows[30:], decode(flicker(GRAY, at(stamp_s=1.205))[0])[:90, 0] / decode(GRAY)[0, 0], atol=0.02
    )
    whole = make("flicker", modulation=0.3, readout_s=0)(GRAY, at())[0]
    assert len(np.unique(whole)) == 1


def test_the_camera_amplifies_what_night_leaves_until_it_cannot():
    dusk, night = (make("day_to_night", stops=stops, gain=16) for stops in (3, 8))
    light = decode(GRAY)[0, 0]
    assert decode(dusk(GRAY, at())[0]).mean() == pytest.approx(light, rel=0.02)
    assert decode(night(GRAY, at())[0]).mean() == pytest.approx(light / 16, rel=0.05)
    assert dusk(GRAY, at())[0].std() > 1
    lit = decode(make("day_to_night", stops=8, gain=16, lamp=0.02)(GRAY, at())[0])
    assert lit[55:65, 75:85].mean() > 1.5 * lit[:10, :10].mean()


def test_more_loss_loses_the_same_packets_and_more():
    lost = [make("bandwidth_loss", share=share)(IMAGE, at(frame=5))[0] != IMAGE for share in (0.2, 0.5)]
    assert (lost[0] & ~lost[1]).sum() == 0 and lost[1].sum() > lost[0].sum() > 0
    blocks = lost[1][:112].reshape(7, 16, 10, 16).any(axis=(1, 3))
    share = make("bandwidth_loss", share=0.5)(IMAGE, at(frame=5))[1]
    assert blocks.mean() == pytest.approx(share, abs=0.1)


def test_lost_blocks_are_flat_or_from_above():
    image = np.tile(np.repeat(np.arange(0, 240, 30, dtype=np.uint8), 16)[:120, None], (1, 160))
    for frame in range(10):
        out, _ = make("bandwidth_loss", share=0.6)(image, at(frame))
        blocks = out[:112].reshape(7, 16, 10, 16)
        assert (blocks == blocks[:, :1, :, :1]).all()
        # What is shown comes from a row that was sent before, or nothing was.
        shown = blocks[:, 0, :, 0]
        assert ((shown <= image[::16][:7, :1]) | (shown == 128)).all()


def test_a_flare_adds_its_veil_and_most_at_the_light():
    dark = np.zeros((120, 160), np.uint8)
    flare = make("lens_flare", veil=0.02, off_axis_deg=15)
    out, veil = flare(dark, at())
    assert veil == pytest.approx(0.02, rel=1e-3) and (out > 0).all()
    y, x = np.unravel_index(cv2.GaussianBlur(out, (0, 0), 3).argmax(), out.shape)
    off_axis_deg = np.degrees(np.arctan(np.hypot(x - CAMERA.cx, y - CAMERA.cy) / CAMERA.fx))
    assert off_axis_deg == pytest.approx(15, abs=2) and y < CAMERA.cy


def test_the_light_stays_where_it_is_when_the_camera_turns():
    class Turning:
        def T_world_cam(self, stamp_s):
            T = np.eye(4)
            T[:3, :3] = cv2.Rodrigues(np.array([0, np.radians(10) * (stamp_s - 1), 0]))[0]
            return T

    flare = make("lens_flare", veil=0.02, off_axis_deg=0)
    places = []
    for stamp_s in (1.0, 2.0):
        out = flare(np.zeros((120, 160), np.uint8), at(stamp_s=stamp_s, motion=Turning()))[0]
        places.append(np.unravel_index(cv2.GaussianBlur(out, (0, 0), 3).argmax(), out.shape)[1])
    assert places[0] - places[1] == pytest.approx(CAMERA.fx * np.tan(np.radians(10)), abs=3)


def test_cracks_grow_from_the_same_point():
    few, many = (make("cracked_lens", cracks=cracks, bend_deg=0) for cracks in (3, 10))
    hidden = [np.abs(one(IMAGE, at())[0].astype(int) - IMAGE) > 0 for one in (few, many)]
    assert hidden[0].sum() < hidden[1].sum() < 0.9 * IMAGE.size
    # Cracks that were there remain; only their glint may be another's where they meet.
    assert (hidden[0] & ~hidden[1]).mean() < 0.02


def test_what_is_in_focus_stays_and_the_rest_is_spread_over_its_disc():
    points = np.zeros((120, 160), np.uint8)
    points[60, 40] = points[60, 120] = 255
    depth_m = np.full(points.shape, 1.0, np.float32)
    depth_m[:, 80:] = 2.0
    out, _ = make("shallow_focus", aperture_mm=150, focus_m=1)(points, at(depth_m=depth_m))
    light = decode(out)
    assert out[60, 40] > 250 and light[:, :60].sum() == pytest.approx(1, rel=0.05)
    blur_px = 120 * 0.15 * (1 - 0.5)
    assert light[:, 100:].sum() == pytest.approx(1, rel=0.1)
    assert (light[:, 100:] > 0.2 / blur_px**2).sum() == pytest.approx(np.pi / 4 * blur_px**2, rel=0.3)


def test_narrow_holes_of_a_depth_image_are_filled_and_the_sky_is_not():
    depth_m = np.full((120, 160), 2.0, np.float32)
    depth_m[:40] = 0  # the sky
    depth_m[80:90, 100:140] = 0  # a dark thing
    filled = fill_narrow_holes(depth_m, CAMERA)
    assert (filled[:40] == 0).all() and (filled[40:] == 2).all()
    assert (depth_m[80:90, 100:140] == 0).all()
    for whole in (np.zeros_like(depth_m), np.ones_like(depth_m)):
        assert fill_narrow_holes(whole, CAMERA) is whole


@pytest.mark.parametrize("text", ["fog:extinction_per_m=0.2", "shallow_focus:aperture_mm=100,focus_m=2"])
def test_a_hole_of_measured_depth_is_no_far_place_and_one_of_exact_depth_is(text, tmp_path):
    hole_m = np.full((120, 160), 2.0, np.float32)
    hole_m[50:60, 50:60] = 0
    recorded = Sequence("desk", CAMERA, np.arange(8) / 30, [IMAGE] * 8, None, [hole_m] * 8, (), {})
    whole = replace(recorded, depths=[np.full_like(hole_m, 2)] * 8)
    rendered = replace(recorded, meta={"spec": {}})
    kind, rest = text.split(":")
    segments = [parse_segment(f"{kind}:start_s=0.1,duration_s=0.1,{rest}")]
    outs = []
    for number, sequence in enumerate((recorded, whole, rendered)):
        (tmp_path / str(number)).mkdir()
        outs.append(degrade_sequence(sequence, segments, 0, tmp_path / str(number)))
    assert [len(np.unique([out.frames[k].tobytes() for out in outs])) for k in (1, 4)] == [1, 2]
    np.testing.assert_array_equal(outs[0].frames[4], outs[1].frames[4])
    np.testing.assert_array_equal(outs[0].depths[4], hole_m)
