"""Folders of images and video files, with a camera from elsewhere."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from dslab import sim
from dslab.scenarios.errors import InputError
from dslab.sim.io.camera_file import read_camera
from dslab.sim.io.forms import load_sequence
from dslab.sim.io.truth import tum_poses_text

SIZE, FPS = (96, 64), 12.5
CAMERA = "fx: 80\nfy: 80\ncx: 47.5\ncy: 31.5\nwidth: 96\nheight: 64\nfps: 20\n"


@pytest.fixture
def camera(tmp_path) -> Path:
    (tmp_path / "cam.yaml").write_text(CAMERA)
    return tmp_path / "cam.yaml"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def images(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for index, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full(SIZE[::-1], 10 * index + 5, np.uint8))
    return folder


def video(path: Path, code: str, count: int = 9, size: tuple[int, int] = SIZE) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), FPS, size)
    for index in range(count):
        writer.write(np.full((*size[::-1], 3), 20 * index + 20, np.uint8))
    writer.release()
    return path


def fault(path: Path, camera: Path | None, *expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load_sequence(path, camera)
    line = str(caught.value)
    assert "\n" not in line and all(part in line for part in expected), line


def test_images_come_in_the_order_of_the_numbers_in_their_names(tmp_path, camera):
    folder = images(tmp_path / "walk", "img_2.png", "img_10.JPG", "img_100.png")
    (folder / "notes.txt").write_text("not an image")
    sequence = load_sequence(folder, camera)
    assert sequence.image_names == ("img_2.png", "img_10.JPG", "img_100.png")
    assert [int(sequence.frames[k].mean().round()) for k in range(3)] == [5, 15, 25]
    np.testing.assert_allclose(sequence.stamps_s, [0, 0.05, 0.1])
    assert sequence.T_world_cam is None and sequence.name == "walk"


@pytest.mark.parametrize(("name", "code"), [("a.mp4", "mp4v"), ("b.AVI", "MJPG"), ("c.mkv", "FFV1")])
def test_a_video_has_its_frames_and_its_times(tmp_path, camera, name, code):
    path = video(tmp_path / name, code)
    steps = []
    sequence = load_sequence(path, camera, lambda *step: steps.append(step))
    assert len(sequence) == 9 and sequence.camera.fps == pytest.approx(FPS)
    np.testing.assert_allclose(sequence.stamps_s, np.arange(9) / FPS, atol=1e-3)
    for index in (8, 0, 3):
        assert abs(sequence.frames[index].mean() - (20 * index + 20)) < 5
    assert steps[-1] == ("decoding", 9, 9)
    # The second time it comes from the cache.
    again = load_sequence(path, camera, lambda *step: steps.append(step))
    np.testing.assert_array_equal(again.frames[5], sequence.frames[5])
    assert len(steps) == 9


@pytest.mark.parametrize("form", ["tum", "kitti", "euroc"])
def test_true_poses_may_lie_in_a_file_of_their_own(tmp_path, camera, form):
    (tmp_path / "walk").mkdir()
    for n in range(4):
        cv2.imwrite(str(tmp_path / "walk" / f"{n}.png"), np.full(SIZE[::-1], 90, np.uint8))
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, :3, :3] = Rotation.random(4, np.random.default_rng(0)).as_matrix()
    T[:, :3, 3] = np.arange(12).reshape(4, 3)
    stamps_s = np.arange(4) / read_camera(camera).fps
    quat_wxyz = np.roll(Rotation.from_matrix(T[:, :3, :3]).as_quat(), 1, axis=1)
    text = {
        "tum": tum_poses_text(stamps_s, T),
        "kitti": "\n".join(" ".join(map(repr, pose[:3].ravel().tolist())) for pose in T),
        "euroc": "\n".join(
            ",".join([str(round(s * 1e9)), *map(repr, [*t.tolist(), *q.tolist()])])
            for s, t, q in zip(stamps_s, T[:, :3, 3], quat_wxyz, strict=True)
        ),
    }[form]
    (tmp_path / "truth.txt").write_text(text + "\n")
    read = load_sequence(tmp_path / "walk", camera, truth=tmp_path / "truth.txt", truth_form=form)
    np.testing.assert_allclose(read.T_world_cam, T, atol=1e-8)
    with pytest.raises(InputError, match=r"absent\.txt: no such file"):
        load_sequence(tmp_path / "walk", camera, truth=tmp_path / "absent.txt", truth_form=form)


def test_python_takes_what_the_command_line_takes(tmp_path, monkeypatch):
    """Names as text, one of several cameras, poses of a file."""
    monkeypatch.chdir(tmp_path)
    video(tmp_path / "walk.mp4", "mp4v")
    camera = {"intrinsics": [80, 80, 47.5, 31.5], "resolution": [96, 64], "camera_model": "pinhole"}
    Path("camchain.yaml").write_text(
        yaml.safe_dump({"cam0": {**camera, "intrinsics": [9] * 4}, "cam1": camera})
    )
    Path("poses.txt").write_text("".join(f"{n / FPS} {n} 0 0 0 0 0 1\n" for n in range(9)))
    read = sim.load_sequence("walk.mp4", camera="camchain.yaml:cam1", truth="poses.txt")
    assert read.camera.fx == 80 and read.T_world_cam[8, 0, 3] == 8
    images(tmp_path / "walk", "0.png", "1.png")
    Path("cam.yaml").write_text(CAMERA)
    assert len(sim.load_sequence("walk", camera="cam.yaml")) == 2


def test_a_folder_of_two_cameras_is_refused(tmp_path, camera):
    images(tmp_path / "walk", *(f"{side}_{n}.png" for n in range(3) for side in ("left", "right")))
    with pytest.raises(InputError, match=r"several kinds \(3 left_#\.png, 3 right_#\.png\)"):
        load_sequence(tmp_path / "walk", camera)


def test_a_video_that_breaks_off_is_refused_unless_forced(tmp_path, camera):
    """The header of the file tells how many frames there were."""
    path = tmp_path / "walk.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, SIZE)
    rng = np.random.default_rng(0)
    for _ in range(40):
        video.write(rng.integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8))
    video.release()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match=r"of its 40 frames can be decoded; copy it again; --force"):
        load_sequence(path, camera)
    assert 10 < len(load_sequence(path, camera, force=True)) < 30


def test_bad_input_is_one_line(tmp_path, camera):
    fault(tmp_path / "no.mp4", camera, "no.mp4", "no such file")
    fault(tmp_path / "no", camera, "no such folder")
    path = video(tmp_path / "a.avi", "MJPG")
    fault(path, None, "says nothing of its camera", "--camera FILE")
    fault(path, tmp_path / "none.yaml", "none.yaml", "no such file")
    camera.write_text(CAMERA.replace("96", "97"))
    fault(path, camera, "a.avi", "is 96x64 pixels", "cam.yaml says 97x64")
    camera.write_text(CAMERA)
    path.write_bytes(b"no video at all" * 50)
    fault(path, camera, "is no readable video", "FFmpeg")
    fault(images(tmp_path / "empty"), camera, "holds no image", ".png")
    small = images(tmp_path / "small", "0.png")
    cv2.imwrite(str(small / "0.png"), np.zeros((40, 40), np.uint8))
    fault(small, camera, "is 40x40 pixels", "cam.yaml")


def test_an_unfinished_decoding_leaves_nothing(tmp_path, camera, cache):
    path = video(tmp_path / "a.mp4", "mp4v")

    def stop(step, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        load_sequence(path, camera, stop)
    assert [entry for entry in cache.iterdir() if any(entry.iterdir())] == []
    assert len(load_sequence(path, camera)) == 9


def test_the_command_takes_them(dslab, tmp_path, camera):
    path = video(tmp_path / "walk.mp4", "mp4v")
    code, _, err = dslab(
        "export", path, "--camera", camera, "--format", "vslam-lab", "--out", tmp_path / "out"
    )
    assert code == 0, err
    assert len(load_sequence(tmp_path / "out")) == 9
    dark = "covered_lens:start_s=0.2,duration_s=0.2,transmission=0"
    code, _, err = dslab("degrade", path, "--camera", camera, "--segment", dark, "--out", tmp_path / "dark")
    assert code == 0, err
    assert (load_sequence(tmp_path / "dark").frames[3] == 0).all()
    code, _, err = dslab("run", path, "--out", tmp_path / "run")
    assert code == 2 and "--camera FILE" in err and err.count("\n") == 1
