"""Input of a system: images of any layout and content, invalid images and times."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import feed, fingerprint, kinds, toy

from dslab.slam.config import default_config
from dslab.slam.core.events import TrackingState
from dslab.slam.factory import build_system
from dslab.slam.system import MonocularSlam
from dslab.slam.toy_sequence import CAMERA

SHAPE = (CAMERA.height_px, CAMERA.width_px)
GREY = np.zeros(SHAPE, np.uint8)


def base():
    return build_system("base", CAMERA)


@pytest.fixture(scope="module")
def sequence():
    return toy(100, step_m=0.05)


@pytest.fixture(scope="module")
def healthy(sequence):
    """A snapshot of a system that is tracking, by kind, and that of the base after 15 frames."""
    images, stamps_s, _ = sequence
    snapshots = {}
    for kind in ("base", "dual"):
        system = build_system(kind, CAMERA)
        for i, (image, stamp_s) in enumerate(zip(images[:50], stamps_s[:50], strict=True)):
            if i == 15:
                snapshots["start"] = system.snapshot()
            system.process(image, stamp_s)
        assert system.state is TrackingState.TRACKING
        snapshots[kind] = system.snapshot()
    return snapshots


@pytest.mark.parametrize("layout", ["columns", "read_only", "strided", "reused"])
def test_the_layout_of_an_image_in_memory_does_not_matter(sequence, healthy, layout):
    images, stamps_s, _ = sequence
    other = base()
    buffer = np.empty(SHAPE, np.uint8)
    for image, stamp_s in zip(images[:15], stamps_s[:15], strict=True):
        given = image
        if layout == "columns":
            given = np.asfortranarray(image)
        elif layout == "read_only":
            given = image.copy()
            given.flags.writeable = False
        elif layout == "strided":
            given = np.repeat(image, 2, axis=1)[:, ::2]
        else:
            buffer[:] = image
            given = buffer
        other.process(given, stamp_s)
        buffer[:] = 0
    assert other.events and fingerprint(other) == fingerprint(healthy["start"].restore())


# -- misuse --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "image",
    [
        GREY[:-1],
        GREY.T,
        GREY[:0],
        GREY[..., None],
        np.zeros((*SHAPE, 3), np.uint8),
        GREY.astype(np.float32),
        GREY.astype(np.float64),
        GREY.astype(np.int8),
        GREY.astype(np.uint16),
        GREY.astype(bool),
        GREY.tolist(),
        None,
        "frame.png",
    ],
    ids=lambda image: f"{getattr(image, 'dtype', type(image).__name__)}{getattr(image, 'shape', '')}",
)
def test_an_invalid_image_is_refused(image):
    system = base()
    with pytest.raises(ValueError, match="frame 0"):
        system.process(image, 0.0)


@pytest.mark.parametrize("stamp_s", [1.0, 0.5, -1.0, np.nan, np.inf, -np.inf, None, "2.0"])
def test_an_invalid_or_earlier_time_is_refused(stamp_s):
    system = base()
    system.process(GREY, 1.0)
    with pytest.raises(ValueError, match="frame 1"):
        system.process(GREY, stamp_s)


def test_the_first_time_must_be_finite():
    for stamp_s in (np.nan, -np.inf):
        with pytest.raises(ValueError):
            base().process(GREY, stamp_s)
    assert base().process(GREY, -5.0).frame == 0


def test_misuse_leaves_the_system_unchanged(sequence, healthy):
    images, stamps_s, _ = sequence
    abused = base()
    for image, stamp_s in zip(images[:15], stamps_s[:15], strict=True):
        abused.process(image, stamp_s)
        for wrong in ((image[1:], stamp_s + 0.01), (image, stamp_s), (image, np.nan)):
            with pytest.raises(ValueError):
                abused.process(*wrong)
    assert fingerprint(abused) == fingerprint(healthy["start"].restore())


def test_an_unknown_system_and_a_too_small_camera_are_refused():
    with pytest.raises(ValueError, match="unknown system"):
        build_system("triple", CAMERA)
    with pytest.raises(ValueError, match="too small"):
        MonocularSlam(replace(CAMERA, width_px=20, height_px=20, cx=10.0, cy=10.0))


def test_a_wide_camera_gets_more_features():
    assert default_config(CAMERA).orb.n_features == 1000
    assert default_config(replace(CAMERA, width_px=1241, height_px=376)).orb.n_features == 2000


# -- content -------------------------------------------------------------------------------------------------


def corner(_):
    image = np.full(SHAPE, 100, np.uint8)
    image[100:, 150:] = 200
    return image


def checkerboard(_):
    """Thousands of equal corners."""
    y, x = np.indices(SHAPE)
    return (((x // 8 + y // 8) % 2) * 255).astype(np.uint8)


CONTENT = {
    "black": lambda _: np.zeros(SHAPE, np.uint8),
    "white": lambda _: np.full(SHAPE, 255, np.uint8),
    "constant": lambda _: np.full(SHAPE, 120, np.uint8),
    "noise": lambda i: np.random.default_rng(i).integers(0, 256, SHAPE).astype(np.uint8),
    "one_corner": corner,
    "checkerboard": checkerboard,
}


def feed_spoilt(system, sequence, first, end, content, spots):
    """Feed a part of the sequence in which some frames have other content; check every result."""
    images, stamps_s = list(sequence[0][:end]), sequence[1][:end]
    for i in spots:
        images[i] = CONTENT[content](i)
    results = feed(system, images[first:], stamps_s[first:])
    assert {r.frame for r in results if r.state is TrackingState.TRACKING}.isdisjoint(spots)
    for r in results:
        assert (r.T_map_cam is not None) is (r.state is TrackingState.TRACKING)
        assert r.T_map_cam is None or np.isfinite(r.T_map_cam).all()
    for path in system.trajectories():
        assert np.isfinite(path.T_map_cam).all()


@pytest.mark.parametrize("content", CONTENT)
@pytest.mark.slow
def test_no_content_raises_during_initialization(sequence, content):
    system = base()
    feed_spoilt(system, sequence, 0, 30, content, {*range(3), *range(5, 7)})
    assert kinds(system) == ["initialized"]


@pytest.mark.parametrize("kind", ["base", "dual"])
@pytest.mark.parametrize("content", CONTENT)
@pytest.mark.slow
def test_no_content_raises_during_tracking_or_after_a_breakage(sequence, healthy, content, kind):
    """At worst tracking is lost."""
    system = healthy[kind].restore()
    feed_spoilt(system, sequence, 50, 62, content, {*range(50, 53), *range(60, 62)})
    assert "breakage" in kinds(system)


@pytest.mark.parametrize("content", CONTENT)
def test_a_sequence_of_one_content_yields_no_map(content):
    system = build_system("dual", CAMERA, 0)
    for i in range(6):
        result = system.process(CONTENT[content](i), i / 30)
        assert result.state is TrackingState.NOT_INITIALIZED and result.reason
    assert system.maps() == [] and system.trajectories() == [] and system.events == []
