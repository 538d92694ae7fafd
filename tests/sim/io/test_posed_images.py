"""Images with poses and without times: 7-Scenes, ICL-NUIM, ScanNet, Replica, nerfstudio, COLMAP."""

import json
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.forms import Form, detect_form, load_sequence

COUNT = 4
CAMERA = "fx: 80\nfy: 81\ncx: 47\ncy: 31\nwidth: 96\nheight: 64\nfps: 10\n"


def true_poses() -> np.ndarray:
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, :3] = Rotation.random(COUNT, rng).as_matrix()
    T[:, :3, 3] = rng.normal(size=(COUNT, 3))
    return T


def matrix(T: np.ndarray) -> str:
    return "\n".join(" ".join(f"{v:.9f}" for v in row) for row in T) + "\n"


def draw(folder: Path, name: str, size: tuple[int, int] = (96, 64), count: int = COUNT) -> None:
    for n in range(count):
        path = folder / name.format(n)
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full(size[::-1], 20 * n + 10, np.uint8))


def said(folder: Path, *words: str, camera: Path | None = None):
    with pytest.warns(InputNotice) as caught:
        read = load_sequence(folder, camera)
    lines = [str(w.message) for w in caught]
    assert all(any(word in line for line in lines) for word in words), lines
    return read


def test_seven_scenes(tmp_path):
    """Its camera is assumed; a frame whose tracking failed has no true pose."""
    draw(tmp_path, "frame-{:06d}.color.png", (640, 480))
    draw(tmp_path, "frame-{:06d}.depth.png", (640, 480))
    T = true_poses()
    for n in range(COUNT):
        (tmp_path / f"frame-{n:06d}.pose.txt").write_text(matrix(T[n]))
    (tmp_path / "frame-000001.pose.txt").write_text("-1.#IND inf nan 0 " * 4)
    (tmp_path / "frame-000002.pose.txt").unlink()
    read = said(tmp_path, "30 times a second", "taken to be fx 525, fy 525, cx 320, cy 240")
    assert detect_form(tmp_path) is Form.SEVEN_SCENES
    assert read.camera.focal_px == (525, 525) and read.camera.centre_px == (320, 240) and read.depths is None
    np.testing.assert_allclose(read.stamps_s, np.arange(COUNT) / 30)
    np.testing.assert_allclose(read.T_world_cam[[0, 3]], T[[0, 3]], atol=1e-8)
    assert np.isnan(read.T_world_cam[[1, 2]]).all()
    assert read.image_names[3] == "frame-000003.color.png" and read.frames[3].mean() == 70


def test_a_camera_from_elsewhere_counts(tmp_path):
    draw(tmp_path / "seq", "frame-{:06d}.color.png")
    with pytest.raises(InputError, match="which camera took its images of 96x64; add --camera FILE"):
        load_sequence(tmp_path / "seq")
    (tmp_path / "cam.yaml").write_text(CAMERA)
    read = said(tmp_path / "seq", "10 times a second", camera=tmp_path / "cam.yaml")
    assert read.camera.fy == 81 and read.T_world_cam is None
    np.testing.assert_allclose(read.stamps_s, np.arange(COUNT) / 10)
    (tmp_path / "cam.yaml").rename(tmp_path / "seq" / "camera.yaml")
    assert said(tmp_path / "seq", "10 times a second").camera == read.camera
    assert detect_form(tmp_path / "seq") is Form.SEVEN_SCENES


def test_icl_nuim(tmp_path):
    """Its poses are mirrored: here they move down where the file says up; frame 0 has none."""
    draw(tmp_path, "rgb/{}.png", (640, 480))
    for n in range(COUNT):
        (tmp_path / "depth").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"depth/{n}.png"), np.full((480, 640), 10_000, np.uint16))
    turn = Rotation.from_euler("x", 30, degrees=True).as_quat()
    rows = [" ".join(map(str, [n, 0, 0.1 * n, -2.25, *turn])) for n in range(1, COUNT)]
    (tmp_path / "livingRoom1.gt.freiburg").write_text("\n".join(rows))
    (tmp_path / "associations.txt").write_text("0 depth/0.png 0 rgb/0.png\n")
    read = said(tmp_path, "30 times a second", "fx 481.2, fy 480, cx 319.5, cy 239.5")
    assert detect_form(tmp_path) is Form.ICL_NUIM
    assert np.isnan(read.T_world_cam[0]).all()
    np.testing.assert_allclose(read.T_world_cam[2, :3, 3], [0, -0.2, -2.25])
    turned = Rotation.from_matrix(read.T_world_cam[2, :3, :3]).as_euler("xyz", degrees=True)
    np.testing.assert_allclose(turned, [-30, 0, 0], atol=1e-9)
    np.testing.assert_allclose(read.depths[0], 2.0)


def test_scannet(tmp_path):
    """Every twentieth frame; its camera is a file."""
    for n in range(COUNT):
        draw(tmp_path, f"color/{20 * n}.jpg", count=1)
    (tmp_path / "pose").mkdir()
    for n, T in enumerate(true_poses()):
        (tmp_path / f"pose/{20 * n}.txt").write_text(matrix(T) if n else "-inf -inf -inf -inf\n" * 4)
    (tmp_path / "intrinsic").mkdir()
    K = np.eye(4)
    K[0, 0], K[1, 1], K[:2, 2] = 80, 81, (47, 31)
    (tmp_path / "intrinsic/intrinsic_color.txt").write_text(matrix(K))
    read = said(tmp_path, "1.5 times a second")
    assert detect_form(tmp_path) is Form.SCANNET
    assert read.camera.K.tolist() == K[:3, :3].tolist()
    np.testing.assert_allclose(read.stamps_s, 20 * np.arange(COUNT) / 30, rtol=1e-9)
    assert np.isnan(read.T_world_cam[0]).all()
    np.testing.assert_allclose(read.T_world_cam[1:], true_poses()[1:], atol=1e-8)
    (tmp_path / "intrinsic/intrinsic_color.txt").write_text(matrix(K[:3, :3]))
    with pytest.raises(InputError, match=r"intrinsic_color\.txt: 9 numbers where 16 belong"):
        load_sequence(tmp_path)


def test_replica(tmp_path):
    """The camera is beside the folder of the room; a frame that is left out leaves a gap in time."""
    room = tmp_path / "room0"
    draw(room, "results/frame{:06d}.jpg")
    draw(room, "results/depth{:06d}.png")
    (room / "traj.txt").write_text("\n".join(matrix(T).replace("\n", " ") for T in true_poses()))
    camera = {"camera": {"w": 96, "h": 64, "fx": 80.0, "fy": 81.0, "cx": 47.5, "cy": 31.5, "scale": 6553.5}}
    (tmp_path / "cam_params.json").write_text(json.dumps(camera))
    read = said(room, "30 times a second")
    assert detect_form(room) is Form.REPLICA and read.camera.centre_px == (47.5, 31.5)
    np.testing.assert_allclose(read.T_world_cam, true_poses(), atol=1e-8)
    (room / "results/frame000001.jpg").unlink()  # of numbers 0 to 3
    read = said(room, "1 numbers are missing between the images: their time passes")
    np.testing.assert_allclose(read.stamps_s, np.array([0, 2, 3]) / 30)
    np.testing.assert_allclose(read.T_world_cam, true_poses()[[0, 2, 3]], atol=1e-8)
    (room / "traj.txt").write_text(matrix(true_poses()[0]).replace("\n", " "))
    with pytest.raises(InputError, match="has 1 poses for images up to number 3"):
        load_sequence(room)


def test_transforms(tmp_path):
    """OpenGL's axes; without an entry an image is a frame without a pose; sizes are those of the images."""
    draw(tmp_path, "images/frame_{}.jpg", count=12)
    draw(tmp_path, "images/mask_{}.jpg", count=2)
    T = true_poses()
    names = ["frame_10.jpg", "frame_2.jpg", "frame_1.jpg", "frame_0.jpg"]
    frames = [
        {"file_path": f"./images/{name}", "transform_matrix": (pose @ np.diag([1.0, -1, -1, 1])).tolist()}
        for name, pose in zip(names, T, strict=True)
    ]
    data = {"camera_angle_x": 2 * np.arctan(48 / 80), "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    read = said(tmp_path, "30 times a second")
    assert detect_form(tmp_path) is Form.NERFSTUDIO and len(read) == 12
    np.testing.assert_allclose(read.camera.focal_px, (80, 80))
    np.testing.assert_allclose(read.T_world_cam[[10, 2, 1, 0]], T, atol=1e-9)
    assert np.isnan(read.T_world_cam[3]).all() and read.image_names[3] == "images/frame_3.jpg"
    (tmp_path / "transforms.json").write_text(json.dumps(data | {"frames": [*frames, frames[0]]}))
    with pytest.raises(InputError, match=r"frames\[4\]: file_path: ./images/frame_10.jpg is listed twice"):
        load_sequence(tmp_path)
    frames[1]["transform_matrix"][0][0] = 7
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"frames\[1\]: transform_matrix: is no rotation"):
        load_sequence(tmp_path)


def reconstruct(folder: Path, model: str, numbers: list[float]) -> None:
    made = pycolmap.Reconstruction()
    made.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=7, model=model, width=96, height=64, params=numbers)
    )
    for n, T in enumerate(true_poses()):
        inverse = np.linalg.inv(T)
        image = pycolmap.Image(name=f"frame {n}.png", camera_id=7, image_id=n + 1)
        points = [pycolmap.Point2D(np.ones(2))] * n
        image.points2D = pycolmap.Point2DList(points)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(inverse[:3, :3]), inverse[:3, 3])
        made.add_image_with_trivial_frame(image, pose)
    folder.mkdir(parents=True)
    made.write_text(folder)
    made.write_binary(folder)


@pytest.mark.parametrize("kind", ["bin", "txt"])
@pytest.mark.parametrize(
    ("model", "numbers"), [("SIMPLE_RADIAL", [80, 48, 32, 0.01]), ("PINHOLE", [80, 81, 48, 32])]
)
def test_colmap(tmp_path, kind, model, numbers):
    """As pycolmap writes it; points and images without a pose do not matter."""
    draw(tmp_path, "images/frame {}.png", count=6)
    reconstruct(tmp_path / "sparse/0", model, numbers)
    for path in (tmp_path / "sparse/0").iterdir():
        if path.suffix != f".{kind}":
            path.unlink()
    read = said(tmp_path, "30 times a second", "this reconstruction's unit of length")
    assert detect_form(tmp_path) is Form.COLMAP and len(read) == 6
    assert read.camera.focal_px == (80, numbers[1] if model == "PINHOLE" else 80)
    assert read.camera.centre_px == (47.5, 31.5)
    np.testing.assert_allclose(read.T_world_cam[:COUNT], true_poses(), atol=1e-9)
    assert np.isnan(read.T_world_cam[COUNT:]).all()
    if kind == "bin":
        images = tmp_path / "sparse/0/images.bin"
        images.write_bytes(images.read_bytes()[:-5])
        with pytest.raises(InputError, match=r"images\.bin: is cut short or no list of images"):
            load_sequence(tmp_path)
