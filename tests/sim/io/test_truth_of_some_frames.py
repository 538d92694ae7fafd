"""Truth of some frames alone, and on another clock than the frames."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from io_sequences import COUNT, make_sequence

from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.clock import ORIGIN_KEY
from dslab.sim.io.forms import Form, load_sequence, write_sequence
from dslab.sim.io.truth import tum_poses_text

ORIGIN_S = 1_403_636_579


def written(folder: Path, form: Form, origin_s: int = 0) -> Path:
    sequence = replace(make_sequence(), depths=None)
    if form is Form.EUROC:
        sequence = replace(sequence, meta={ORIGIN_KEY: origin_s * 10**9})
    else:
        sequence = replace(sequence, stamps_s=sequence.stamps_s + origin_s)
    write_sequence(sequence, folder, form)
    return folder


def truth_file(path: Path, first_s: float, frames: slice = slice(None)) -> Path:
    made = make_sequence()
    path.write_text(tum_poses_text(made.stamps_s[frames] + first_s, made.T_world_cam[frames]))
    return path


def test_truth_since_1970_fits_stamps_whose_origin_is_known(tmp_path):
    folder = written(tmp_path / "seq", Form.EUROC, ORIGIN_S)
    for first_s in (ORIGIN_S, 0):
        read = load_sequence(folder, truth=truth_file(tmp_path / "truth.txt", first_s))
        np.testing.assert_allclose(read.T_world_cam, make_sequence().T_world_cam, atol=1e-8)


@pytest.mark.parametrize(("frames_s", "truth_s"), [(0, ORIGIN_S), (ORIGIN_S, 0)])
def test_truth_on_another_clock_is_one_line_with_the_difference(tmp_path, frames_s, truth_s):
    folder = written(tmp_path / "seq", Form.TUM, frames_s)
    with pytest.raises(InputError) as caught:
        load_sequence(folder, truth=truth_file(tmp_path / "truth.txt", truth_s))
    line = str(caught.value)
    assert f"no stamp of {truth_s}" in line and "give both files the same clock" in line
    assert f"({frames_s - truth_s:+d} s here, if both began together)" in line and "\n" not in line


def test_truth_of_few_frames_is_said_and_of_one_is_none(tmp_path):
    folder = written(tmp_path / "seq", Form.TUM)
    few = r"truth covers 3 of 6 frames, from 0\.033333333 to 0\.1 s: ATE speaks of these alone"
    with pytest.warns(InputNotice, match=few):
        read = load_sequence(folder, truth=truth_file(tmp_path / "truth.txt", 0, slice(1, 4)))
    assert np.isfinite(read.T_world_cam).all(axis=(1, 2)).tolist() == [False, *[True] * 3, *[False] * 2]
    with pytest.warns(InputNotice, match="one frame has a true pose: nothing can be aligned"):
        read = load_sequence(folder, truth=truth_file(tmp_path / "truth.txt", 0, slice(2, 3)))
    assert read.T_world_cam is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(load_sequence(folder).T_world_cam) == COUNT
