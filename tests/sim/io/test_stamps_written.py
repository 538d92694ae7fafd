"""Stamps through every form: as they were read, to the nanosecond, or refused before anything is written."""

from dataclasses import replace

import numpy as np
import pytest
from io_sequences import make_sequence

from dslab.scenarios.errors import InputError
from dslab.sim.io.clock import written_ns
from dslab.sim.io.forms import Form, load_sequence, write_sequence
from dslab.sim.sensors.camera import Intrinsics

FIRST = 1403636579763555584
WRITTEN = (Form.TUM, Form.KITTI, Form.EUROC, Form.VSLAM_LAB)


def pinhole():
    sequence = make_sequence()
    height, width = sequence.frames[0].shape
    camera = Intrinsics(width, height, 50.0, 50.0, (width - 1) / 2, (height - 1) / 2, 30.0)
    return replace(sequence, camera=camera)


@pytest.mark.parametrize("form", WRITTEN)
@pytest.mark.parametrize("source", [Form.TUM, Form.KITTI])
def test_seconds_since_1970_keep_every_nanosecond(source, form, tmp_path):
    sequence = pinhole()
    stamps = [FIRST + 33_333_331 * k for k in range(len(sequence))]
    since = replace(
        sequence, stamps_s=np.array([stamp / 10**9 for stamp in stamps]), stamps_ns=np.array(stamps)
    )
    write_sequence(since, tmp_path / "source", source)
    read = load_sequence(tmp_path / "source")
    assert written_ns(read) == stamps and read.stamps_s.tolist() == [stamp / 10**9 for stamp in stamps]
    write_sequence(read, tmp_path / "out", form)
    again = load_sequence(tmp_path / "out")
    assert written_ns(again) == stamps
    np.testing.assert_allclose(again.T_world_cam, sequence.T_world_cam, atol=1e-8)
    assert written_ns(read.only(np.array([1, 3]))) == [stamps[1], stamps[3]]
    # Stamps that were changed since are those of now.
    shifted = written_ns(replace(read, stamps_s=read.stamps_s + 1))
    assert abs(shifted[0] - stamps[0] - 10**9) < 1000


@pytest.mark.parametrize(
    ("form", "step_s", "first_s", "said"),
    [
        (Form.EUROC, 1 / 30, -1.0, "stamps below 0"),
        (Form.VSLAM_LAB, 1 / 30, -1.0, "stamps below 0"),
        (Form.EUROC, 1 / 30, 1e10, "stamps above"),
        (Form.KITTI, 86400.0, 0.0, "no frame rate"),
        (Form.KITTI, 1e-7, 0.0, "no frame rate"),
        (Form.TUM, 1e6 / 30, 0.0, "divide them by 1000000"),
        *((form, 1e-10, 0.0, "less than a nanosecond apart") for form in WRITTEN),
    ],
)
def test_what_would_not_be_read_back_is_not_written(form, step_s, first_s, said, tmp_path):
    sequence = pinhole()
    wrong = replace(sequence, stamps_s=first_s + step_s * np.arange(len(sequence)))
    with pytest.raises(InputError, match=said):
        write_sequence(wrong, tmp_path / "out", form)
    assert not (tmp_path / "out").exists()
