"""The real SLAM in threaded mode, and its map in the form of other tools."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from slam_fakes import fake_factory, make_sequence, run_sequence, simulated_camera

from dslab.experiments.runs import execution, sources
from dslab.experiments.runs.execution import system_factory
from dslab.experiments.runs.map_files import write_maps
from dslab.experiments.runs.sources import open_sequence
from dslab.sim.io.forms import Form, write_sequence
from dslab.sim.sequence import Sequence
from dslab.slam.toy_sequence import CAMERA, toy_frames


@pytest.fixture(scope="module")
def sequence():
    images, stamps_s, poses = zip(*toy_frames(70, step_m=0.05), strict=True)
    return Sequence(
        name="toy",
        camera=simulated_camera(CAMERA),
        stamps_s=np.array(stamps_s),
        frames=images,
        T_world_cam=np.array(poses),
        depths=None,
        segments=(),
        meta={},
        image_names=tuple(f"shots/{i:03d}.png" for i in range(70)),
    )


@pytest.fixture(scope="module")
def summary(sequence, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "r"
    return run_sequence(sequence, "base", 0, folder, maps=True), folder


def test_the_mode_is_recorded(summary):
    assert summary[0]["config"]["mode"] == "lockstep"


@pytest.mark.parametrize("paced", [False, True])
@pytest.mark.slow
def test_a_threaded_run_tracks_and_records_its_mode(sequence, summary, tmp_path, paced):
    threaded = run_sequence(
        sequence, "base", 0, tmp_path / "r", build=system_factory("threaded"), real_time=paced
    )
    assert threaded["config"]["mode"] == "threaded"
    assert threaded["frames"] + threaded["dropped_frames"] == len(sequence)
    assert paced or threaded["dropped_frames"] == 0
    # The number of frames in time depends on the machine, the quality of the map does not.
    if not paced:
        assert threaded["tracked"] >= 0.9 * summary[0]["tracked"]
        assert threaded["ate_share_of_path"] < 0.02


def test_the_written_map_is_read_back_with_its_images(sequence, summary):
    figures, folder = summary
    model = pycolmap.Reconstruction(folder / "map")
    assert model.num_reg_images() == figures["keyframes"]
    assert model.num_points3D() == figures["map_points"]
    assert {image.name for image in model.images.values()} <= set(sequence.image_names)
    # The points have the grey of the images: the boards are textured.
    assert np.std([point.color[0] for point in model.points3D.values()]) > 10
    assert (folder / "map" / "points.ply").read_bytes().startswith(b"ply")


class _Two:
    """The same map under two numbers."""

    camera = CAMERA

    def __init__(self, map_):
        self._map = map_

    def maps(self):
        return [0, 3]

    def map(self, map_id):
        return self._map


def test_several_maps_have_a_folder_each(sequence, tmp_path):
    system = system_factory()("base", CAMERA, 0)
    for image, stamp_s in zip(sequence.frames, sequence.stamps_s, strict=True):
        system.process(image, float(stamp_s))
    write_maps(tmp_path / "map", _Two(system.map(0)), replace(sequence, image_names=()))
    assert {p.name for p in (tmp_path / "map").iterdir()} == {"0", "3"}
    model = pycolmap.Reconstruction(tmp_path / "map" / "3")
    assert all(image.name == f"{int(image.name[:6]):06d}.png" for image in model.images.values())


def test_a_recording_in_real_time_is_refused(sequence, tmp_path):
    with pytest.raises(ValueError, match="recording"):
        run_sequence(sequence, "base", 0, tmp_path / "r", recording=True, real_time=True)


@pytest.mark.parametrize(
    ("form", "first"),
    [(Form.TUM, "rgb/000000.png"), (Form.KITTI, "image_0/000000.png"), (Form.EUROC, "mav0/cam0/data/")],
)
def test_images_are_named_as_in_the_folder(tmp_path, form, first):
    write_sequence(make_sequence(5, segment=None), tmp_path / "s", form)
    loaded = open_sequence(str(tmp_path / "s"))
    assert loaded.image_names[0].startswith(first)
    for name, frame in zip(loaded.image_names, loaded.frames, strict=True):
        np.testing.assert_array_equal(cv2.imread(str(tmp_path / "s" / name), cv2.IMREAD_GRAYSCALE), frame)


@pytest.fixture
def dslab(dslab, monkeypatch):
    """The command on a few synthetic frames, with the fake system."""
    few = make_sequence(12, segment=None)
    monkeypatch.setattr("dslab.slam.warmup.warm_up", lambda progress: None)
    monkeypatch.setattr(sources, "open_sequence", lambda source, seed, show, **options: few)
    monkeypatch.setattr(execution, "system_factory", lambda mode="lockstep", dual=None: fake_factory(few))
    return dslab


def test_bench_in_real_time_counts_dropped_frames(dslab):
    code, out, _ = dslab("bench", "x", "--mode", "threaded", "--real-time", "--runs", "2", "--json")
    figures = json.loads(out.splitlines()[-1])
    assert code == 0 and figures["mode"] == "threaded"
    assert len(figures["dropped_frames"]) == 2
    assert figures["frames"] == 12
    code, _, err = dslab("bench", "x", "--real-time")
    assert code == 2 and err.startswith("error: --real-time: the mode is lockstep; add --mode threaded")


def test_run_in_real_time_is_warm_and_counts_dropped_frames(dslab, tmp_path, monkeypatch):
    warmed = []
    monkeypatch.setattr("dslab.slam.warmup.warm_up", warmed.append)
    code, out, _ = dslab("run", "x", "--out", tmp_path / "r", "--mode", "threaded", "--real-time", "--json")
    summary = json.loads(out.splitlines()[-1])
    assert code == 0 and summary["frames"] + summary["dropped_frames"] == 12
    assert len(warmed) == 1


@pytest.mark.parametrize(
    ("arguments", "starts"),
    [
        (["--real-time"], "error: --real-time: the mode is lockstep; add --mode threaded"),
        (["--real-time", "--mode", "threaded", "--rerun"], "error: --rerun: a recording takes time"),
    ],
)
def test_options_that_exclude_each_other_are_one_line_and_exit_2(dslab, tmp_path, arguments, starts):
    code, out, err = dslab("run", "x", "--out", tmp_path / "r", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(starts) and err.count("\n") == 1
    assert not (tmp_path / "r").exists()
