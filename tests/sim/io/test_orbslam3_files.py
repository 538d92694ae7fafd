"""What ORB-SLAM3's own programs need lies beside a written sequence."""

from dataclasses import replace

import pytest
from io_sequences import COUNT, make_sequence

from dslab.sim.io.camera_file import read_camera
from dslab.sim.io.forms import Form, write_sequence

FISHEYE = {"model": "equidistant", "distortion": (0.01, -0.02, 0.003, 0.0)}
NO_K3 = {"distortion": (0.1, -0.2, 0.001, 0.002, 0.0)}


@pytest.mark.parametrize("form", [Form.TUM, Form.EUROC, Form.VSLAM_LAB])
@pytest.mark.parametrize("lens", [{}, NO_K3, FISHEYE])
def test_its_settings_hold_the_camera(tmp_path, form, lens):
    sequence = make_sequence()
    sequence = replace(sequence, camera=replace(sequence.camera, **lens))
    write_sequence(sequence, tmp_path / "seq", form)
    path = tmp_path / "seq" / "orbslam3.yaml"
    # OpenCV's header, then keys as its documentation of version 1.0 names them.
    assert path.read_text().startswith('%YAML:1.0\nFile.version: "1.0"\nCamera.type: "')
    assert read_camera(path) == sequence.camera


def test_a_lens_that_it_lacks_has_no_settings(tmp_path):
    camera = replace(make_sequence().camera, model="rational", distortion=(0.1, 0, 0, 0, 0, 0.1, 0, 0))
    write_sequence(replace(make_sequence(), camera=camera), tmp_path / "seq", Form.TUM)
    assert not (tmp_path / "seq" / "orbslam3.yaml").exists()


def test_its_lists_of_frames_are_complete(tmp_path):
    """One of nanoseconds for EuRoC; of TUM's list three lines are passed over."""
    write_sequence(make_sequence(), tmp_path / "euroc", Form.EUROC)
    stamps = (tmp_path / "euroc" / "orbslam3_times.txt").read_text().split()
    images = sorted(path.stem for path in (tmp_path / "euroc/mav0/cam0/data").iterdir())
    assert stamps == sorted(images, key=int) and len(stamps) == COUNT
    write_sequence(make_sequence(), tmp_path / "tum", Form.TUM)
    lines = (tmp_path / "tum" / "rgb.txt").read_text().splitlines()
    assert [line[0] for line in lines[:3]] == ["#"] * 3 and len(lines[3:]) == COUNT
