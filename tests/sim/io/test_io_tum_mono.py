"""The TUM-mono form: photometric correction, the FOV lens, one line per fault."""

import zipfile
from decimal import Decimal
from pathlib import Path

import cv2
import numpy as np
import pytest
from io_sequences import edit, fault

from dslab.scenarios.errors import InputError
from dslab.sim.io.clock import written_ns
from dslab.sim.io.forms import Form, detect_form, load_sequence, write_sequence
from dslab.sim.io.fov_camera import FovCamera, read_fov_camera

# The lens and size of the data set.
LENS = "0.535719308086809 0.669566858850269 0.493248545285398 0.500408664348414 0.897966326944875"
CAMERA = f"{LENS}\n160 128\ncrop\n80 60\n"
COUNT, SHAPE, EXPOSURE_MS = 4, (128, 160), 5.5
RESPONSE = 255 * (np.arange(256) / 255) ** 2.2
VIGNETTE = (65535 * np.linspace(0.5, 1, SHAPE[1])[None].repeat(SHAPE[0], 0)).astype(np.uint16)


def scene(lens: FovCamera, rays_to_light) -> np.ndarray:
    """The image that a lens takes of a scene given as light per ray."""
    x, y = np.meshgrid(np.arange(lens.width_px), np.arange(lens.height_px))
    return rays_to_light(lens.unproject(np.stack([x, y], axis=-1).astype(float)))


def waves(rays: np.ndarray) -> np.ndarray:
    return 120 + 60 * np.sin(4 * rays[..., 0]) * np.cos(3 * rays[..., 1])


def lens_of(folder: Path) -> FovCamera:
    return read_fov_camera(folder / "camera.txt", 20.0)[0]


@pytest.fixture
def folder(tmp_path) -> Path:
    """Every image shows the same waves, through response and vignette."""
    home = tmp_path / "seq"
    (home / "images").mkdir(parents=True)
    (home / "camera.txt").write_text(CAMERA)
    (home / "times.txt").write_text("".join(f"{i:05d} {i / 20:.6f} {EXPOSURE_MS}\n" for i in range(COUNT)))
    (home / "pcalib.txt").write_text(" ".join(f"{value:.6f}" for value in RESPONSE) + "\n")
    cv2.imwrite(str(home / "vignette.png"), VIGNETTE)
    light = scene(lens_of(home), waves) * (VIGNETTE / VIGNETTE.max())
    taken = np.rint(np.interp(light, RESPONSE, np.arange(256))).astype(np.uint8)
    for index in range(COUNT):
        cv2.imwrite(str(home / f"images/{index:05d}.png"), taken)
    return home


def test_frames_show_the_light_of_the_pinhole_camera(folder):
    assert detect_form(folder) is Form.TUM_MONO
    sequence = load_sequence(folder)
    camera = sequence.camera
    assert camera.is_pinhole and (camera.width_px, camera.height_px) == (80, 60)
    x, y = np.meshgrid(np.arange(80), np.arange(60))
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy], axis=-1)
    # A level of the dark end of the response stands for less light than one of the bright end: 2 levels.
    np.testing.assert_allclose(sequence.frames[1].astype(float), waves(rays), atol=2.5)
    assert sequence.frames[1].dtype == np.uint8
    np.testing.assert_allclose(sequence.stamps_s, np.arange(COUNT) / 20)
    np.testing.assert_allclose(sequence.frame_truth["exposure_s"], EXPOSURE_MS / 1000)
    np.testing.assert_allclose(sequence.exposure_s, EXPOSURE_MS / 1000)
    assert len(sequence.only(np.array([1])).exposure_s) == 1
    (folder / "pcalib.txt").unlink()
    assert load_sequence(folder).exposure_s is None, "levels are not proportional to the light"
    assert camera.fps == pytest.approx(20)


@pytest.mark.parametrize("file", ["pcalib.txt", "vignette.png"])
def test_the_correction_comes_from_its_files(folder, file):
    whole = load_sequence(folder).frames[0].astype(int)
    (folder / file).unlink()
    assert np.abs(load_sequence(folder).frames[0] - whole).max() > 20


def test_an_archive_reads_as_the_folder_does(folder):
    expected = [load_sequence(folder).frames[i] for i in range(COUNT)]
    with zipfile.ZipFile(folder / "images.zip", "w") as archive:
        for path in sorted((folder / "images").iterdir()):
            archive.write(path, path.name)
            path.unlink()
    (folder / "images").rmdir()
    frames = load_sequence(folder).frames
    for index, image in enumerate(expected):
        np.testing.assert_array_equal(frames[index], image)
    (folder / "images.zip").write_bytes((folder / "images.zip").read_bytes()[:3000])
    fault(folder, "images.zip", "no readable zip")


@pytest.mark.filterwarnings("ignore:.*truth covers")
def test_truth_with_gaps_is_read(folder):
    lines = ["0.00 1 2 3 0 0 0 1", "0.05 nan nan nan nan nan nan nan", "0.15 4 5 6 0 0 0 1"]
    (folder / "groundtruthSync.txt").write_text("\n".join(lines))
    T = load_sequence(folder).T_world_cam
    np.testing.assert_array_equal(np.isfinite(T).all(axis=(1, 2)), [True, False, False, True])
    np.testing.assert_array_equal(T[3, :3, 3], [4, 5, 6])


def test_projection_of_the_lens_is_the_papers():
    lens = FovCamera(160, 128, 85.0, 84.0, 79.0, 63.0, 0.9)
    rays = np.random.default_rng(0).uniform(-1, 1, (50, 2))
    radius = np.hypot(*rays.T)
    bent = np.arctan(2 * radius * np.tan(0.9 / 2)) / 0.9
    expected = rays * (bent / radius)[:, None] * (85, 84) + (79, 63)
    np.testing.assert_allclose(lens.project(rays), expected, atol=1e-12)
    np.testing.assert_allclose(lens.unproject(expected), rays, atol=1e-12)
    np.testing.assert_allclose(lens.project(np.zeros((1, 2))), [[79, 63]])
    np.testing.assert_allclose(lens.unproject(np.array([[79.0, 63.0]])), [[0, 0]])
    flat = FovCamera(160, 128, 85.0, 84.0, 79.0, 63.0, 0.0)
    np.testing.assert_allclose(flat.unproject(flat.project(rays)), rays)


def test_a_crop_is_filled_and_touches_every_side(folder):
    lens, camera = read_fov_camera(folder / "camera.txt", 20.0)
    x, y = np.meshgrid(np.arange(80), np.arange(60))
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy], axis=-1)
    at = lens.project(rays)
    low, high = at.min(axis=(0, 1)), at.max(axis=(0, 1))
    assert (low > -1e-6).all() and (low < 0.2).all()
    assert (high < np.array([159, 127]) + 1e-6).all() and (high > np.array([159, 127]) - 0.2).all()


def test_a_stated_rectification_is_used(folder):
    edit(folder / "camera.txt", "crop", "0.4 0.53 0.5 0.5 0")
    camera = load_sequence(folder).camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((32, 31.8, 39.5, 29.5))


def test_tum_mono_is_written_only_in_other_forms(folder, tmp_path):
    sequence = load_sequence(folder)
    with pytest.raises(InputError, match="read, not written"):
        write_sequence(sequence, tmp_path / "out", Form.TUM_MONO)
    write_sequence(sequence, tmp_path / "out", Form.TUM)
    again = load_sequence(tmp_path / "out")
    np.testing.assert_array_equal(again.frames[2], sequence.frames[2])
    assert again.camera == sequence.camera


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("times.txt", "0.100000", "0.01", ["times.txt:3: stamp", "does not come after"]),
        ("times.txt", "0.150000 5.5", "0.150000", ["times.txt:4", "2 numbers where 3", "exposure_ms"]),
        ("times.txt", "00003 0.150000 5.5\n", "", ["images", "4 images, times.txt 3 stamps"]),
        ("camera.txt", "crop\n", "", ["camera.txt", "3 lines where 4"]),
        ("camera.txt", "0.535719308086809", "-0.5", ["camera.txt:1", "shares of the image"]),
        ("camera.txt", "0.897966326944875", "2.5", ["camera.txt:1: omega", "degrees"]),
        ("camera.txt", "160 128", "161 128", ["160x128 pixels, camera.txt says 161x128", "00000.png"]),
        ("pcalib.txt", "0.000000 ", "", ["pcalib.txt", "255 numbers where 256"]),
        ("pcalib.txt", "0.000000 ", "9.0 ", ["pcalib.txt:1: level 1", "does not grow"]),
    ],
)
def test_each_fault_of_a_file_names_place_and_field(folder, file, old, new, expected):
    if "161" in new:
        (folder / "vignette.png").unlink()
    edit(folder / file, old, new)
    fault(folder, *expected)


def test_a_vignette_of_another_camera_is_refused(folder):
    cv2.imwrite(str(folder / "vignette.png"), VIGNETTE[:, :150])
    fault(folder, "vignette.png", "150x128", "160x128")
    cv2.imwrite(str(folder / "vignette.png"), np.zeros(SHAPE, np.uint8))
    fault(folder, "vignette.png", "is black")


def test_folders_of_no_form_are_refused(tmp_path):
    fault(tmp_path, "no sequence of a known form", "KITTI", "EuRoC", "TUM-mono")
    fault(tmp_path / "none", "no such folder")


def test_stamps_since_1970_keep_every_nanosecond(folder):
    rows = [line.split() for line in (folder / "times.txt").read_text().splitlines()]
    stamps = [1403636579763555584 + 33_333_331 * k for k in range(len(rows))]
    lines = [
        f"{row[0]} {Decimal(s).scaleb(-9)} {' '.join(row[2:])}" for row, s in zip(rows, stamps, strict=True)
    ]
    (folder / "times.txt").write_text("\n".join(lines) + "\n")
    (folder / "groundtruthSync.txt").unlink(missing_ok=True)
    assert written_ns(load_sequence(folder)) == stamps
