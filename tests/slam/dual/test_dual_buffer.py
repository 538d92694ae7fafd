"""The feature buffer is a ring, grows while frozen, and never exceeds its cap."""

import numpy as np
import pytest
from dual_scenes import RECOVERY_ONLY, STEP_M, dual, with_own_threads
from slam_scenes import FPS, make_frame, toy

from dslab.slam.dual.buffer import FeatureBuffer
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.orb import OrbRecovery

RNG = np.random.default_rng(0)
FRAMES = [make_frame(i, RNG, n=8 + i % 5).features for i in range(200)]


def filled(count, span_s=1.0, cap_s=4.0, frozen_from=None):
    buffer = FeatureBuffer(span_s, cap_s)
    for i in range(count):
        if i == frozen_from:
            buffer.frozen = True
        buffer.append(FRAMES[i])
    return buffer


def held(buffer):
    return [f.index for f in buffer.backward_from(10**9)][::-1]


def test_the_ring_holds_its_span_only():
    buffer = FeatureBuffer(1.0, 4.0)
    for i in range(100):
        buffer.append(FRAMES[i])
        expected = [j for j in range(i + 1) if FRAMES[i].stamp_s - FRAMES[j].stamp_s <= 1.0]
        assert held(buffer) == expected
        assert len(buffer) == len(expected)


def test_a_frozen_buffer_keeps_its_frames_and_grows():
    buffer = filled(110, frozen_from=50)
    assert held(buffer) == list(range(held(filled(50))[0], 110))


def test_a_frozen_buffer_never_exceeds_its_cap():
    buffer = filled(190, frozen_from=50)
    first = held(buffer)[0]
    assert FRAMES[189].stamp_s - FRAMES[first].stamp_s <= 4.0 + 1e-9
    assert len(buffer) >= 4.0 * FPS - 1


def test_a_released_buffer_is_a_ring_again():
    buffer = filled(110, frozen_from=50)
    buffer.frozen = False
    buffer.append(FRAMES[110])
    assert held(buffer) == held(filled(111))


def test_backward_frames_are_newest_first():
    buffer = filled(60)
    first = held(buffer)[0]
    assert [f.index for f in buffer.backward_from(50)] == list(range(49, first - 1, -1))
    assert next(buffer.backward_from(50)) is FRAMES[49]
    assert list(buffer.backward_from(first)) == []
    assert len(buffer) == 60 - first, "looking takes nothing out"


def test_the_buffer_reaches_held_and_newer_frames():
    buffer = filled(60)
    first = held(buffer)[0]
    assert not buffer.reaches(first - 1)
    assert buffer.reaches(first) and buffer.reaches(59)
    assert not FeatureBuffer(1.0, 1.0).reaches(0)


def test_the_size_is_that_of_the_held_frames():
    buffer = filled(70)
    assert buffer.nbytes == sum(FRAMES[i].nbytes for i in held(buffer)) > 0
    assert FeatureBuffer(1.0, 1.0).nbytes == 0


@pytest.mark.parametrize(("span_s", "cap_s"), [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (np.nan, 1.0)])
def test_invalid_spans_are_refused(span_s, cap_s):
    with pytest.raises(ValueError, match="span_s"):
        FeatureBuffer(span_s, cap_s)


# -- images --------------------------------------------------------------------------------------------------


def picture(i):
    """A different smooth (48, 64) image for every frame."""
    y, x = np.mgrid[:48, :64]
    return (128 + 60 * np.sin(x / 9 + i) + 40 * np.cos(y / 7 - i)).astype(np.uint8)


def pictured(count, span_s=1.0):
    buffer = FeatureBuffer(span_s, 4.0, images=True)
    for i in range(count):
        buffer.append(FRAMES[i], picture(i))
    return buffer


def test_images_are_compressed_with_little_loss():
    buffer = pictured(20)
    images = buffer.images()
    for i in range(20):
        image = images(i)
        assert image.shape == (48, 64) and image.dtype == np.uint8
        assert np.abs(image.astype(int) - picture(i)).mean() < 2
    packed = buffer.nbytes - sum(FRAMES[i].nbytes for i in range(20))
    assert 0 < packed < 20 * picture(0).nbytes


def test_images_leave_with_their_frames():
    buffer = pictured(60)
    images, here = buffer.images(), held(buffer)
    for i in range(60):
        if i in here:
            images(i)
        else:
            with pytest.raises(KeyError, match=f"frame {i} is not held"):
                images(i)
    again = pictured(200)
    assert again.nbytes < 1.5 * buffer.nbytes, "memory does not grow with the run"


def test_returned_images_outlive_the_ring():
    buffer = pictured(30)
    images = buffer.images()
    for i in range(30, 150):
        buffer.append(FRAMES[i], picture(i))
    assert 5 not in held(buffer)
    np.testing.assert_allclose(images(5), picture(5), atol=20)
    with pytest.raises(KeyError):
        images(100)


def test_images_are_held_only_on_request():
    buffer = FeatureBuffer(1.0, 4.0)
    buffer.append(FRAMES[0], picture(0))
    assert buffer.nbytes == FRAMES[0].nbytes
    with pytest.raises(KeyError):
        buffer.images()(0)


class Looking(OrbRecovery):
    """A thread that works on images."""

    needs_images = True


def test_a_system_holds_images_only_if_a_thread_needs_them():
    images, stamps_s, _ = toy(6, 0, STEP_M)
    thread = OrbRecovery(RecoveryConfig())
    systems = (
        dual(RECOVERY_ONLY),
        with_own_threads([thread]),
        with_own_threads([thread, Looking(RecoveryConfig())]),
    )
    for system in systems:
        for image, stamp_s in zip(images, stamps_s, strict=True):
            system.process(image, float(stamp_s))
    assert systems[0].buffer.nbytes == systems[1].buffer.nbytes < systems[2].buffer.nbytes
    given = systems[2].buffer.images()
    assert np.abs(given(3).astype(int) - images[3]).mean() < 4
