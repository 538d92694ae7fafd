"""Sequence folders of every form, as small as can be, with all that they may hold."""

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from dslab.experiments.evaluation.evo_result import EvoResult, statistics, write_evo_result
from dslab.sim.io.camera_file import write_camera
from dslab.sim.io.forms import Form, write_sequence
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.imu import ImuModel, ImuReadings
from dslab.sim.sequence import SegmentTruth, Sequence

FRAMES, SHAPE = 5, (64, 96)


def sequence() -> Sequence:
    """Five frames of a camera going forward, with all that a sequence can have."""
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    runs = ((1, 1), (3, 3))
    poses[:, 2, 3] = 0.1 * np.arange(FRAMES)
    return Sequence(
        name="trial",
        camera=Intrinsics(SHAPE[1], SHAPE[0], 70.0, 70.0, 47.5, 31.5, 10.0),
        stamps_s=np.arange(FRAMES) / 10,
        frames=list(rng.integers(0, 256, (FRAMES, *SHAPE), dtype=np.uint8)),
        T_world_cam=poses,
        depths=list(rng.uniform(0.5, 12, (FRAMES, *SHAPE)).astype(np.float32)),
        segments=(SegmentTruth("motion_blur", {"exposure_s": 0.1}, 0.1, 0.3, 1, 3, "blur_px", 4.0, runs),),
        meta={"seed": 3, "spec": {"name": "trial"}},
        frame_truth={"blur_px": np.array([0.0, 9, 2, 8, 0]), "exposure_s": np.full(FRAMES, 0.004)},
    )  # fmt: skip


def tum(folder: Path) -> None:
    write_sequence(sequence(), folder, Form.TUM, depth=True)


def tum_with_lens(folder: Path) -> None:
    lens = (0.1, -0.05, 0.001, 0.002, 0.01)
    one = sequence()
    write_sequence(replace(one, camera=replace(one.camera, distortion=lens)), folder, Form.TUM)


def kitti(folder: Path) -> None:
    write_sequence(sequence(), folder, Form.KITTI)


def euroc(folder: Path) -> None:
    stamps_s = np.arange(0, 0.5, 0.01)
    rng = np.random.default_rng(1)
    rates, forces = rng.normal(size=(2, len(stamps_s), 3))
    readings = ImuReadings(ImuModel(100.0, 1e-3, 1e-4, 1e-2, 1e-3), stamps_s, rates, forces)
    write_sequence(sequence(), folder, Form.EUROC, (readings, None))


def vslam_lab(folder: Path) -> None:
    write_sequence(sequence(), folder, Form.VSLAM_LAB, depth=True)


def tartanair(folder: Path) -> None:
    for name in ("image_left", "depth_left"):
        (folder / name).mkdir(parents=True)
    rng = np.random.default_rng(3)
    for frame in range(FRAMES):
        image = rng.integers(0, 256, SHAPE, dtype=np.uint8)
        cv2.imwrite(str(folder / f"image_left/{frame:06d}_left.png"), image)
        np.save(folder / f"depth_left/{frame:06d}_left_depth.npy", np.full(SHAPE, 2.5, np.float32))
    rows = [f"{0.1 * frame} 0 0 0 0 0 1" for frame in range(FRAMES)]
    (folder / "pose_left.txt").write_text("\n".join(rows) + "\n")
    write_camera(sequence().camera, folder / "camera.yaml")


def images_with_poses(folder: Path) -> None:
    """As ScanNet, Replica, nerfstudio and COLMAP, text and binary, have them."""
    one = sequence()
    images = {
        "scannet": "color/{}.png",
        "room/replica": "results/frame{:06d}.png",
        "nerfstudio": "images/f{}.png",
        "colmap": "images/f{}.png",
    }
    for name, place in images.items():
        for frame, image in enumerate(one.frames):
            path = folder / name / place.format(frame)
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), image)
    rows = [" ".join(map(str, pose.ravel().tolist())) for pose in one.T_world_cam]
    (folder / "scannet/pose").mkdir()
    for frame, row in enumerate(rows):
        (folder / f"scannet/pose/{frame}.txt").write_text(row + "\n")
    (folder / "scannet/intrinsic").mkdir()
    matrix = "70 0 47.5 0\n0 70 31.5 0\n0 0 1 0\n0 0 0 1\n"
    (folder / "scannet/intrinsic/intrinsic_color.txt").write_text(matrix)
    (folder / "room/replica/traj.txt").write_text("\n".join(rows) + "\n")
    camera = {"w": SHAPE[1], "h": SHAPE[0], "fx": 70.0, "fy": 70.0, "cx": 47.5, "cy": 31.5, "scale": 6553.5}
    (folder / "room/cam_params.json").write_text(json.dumps({"camera": camera}))
    frames = [
        {"file_path": f"images/f{frame}.png", "transform_matrix": pose.tolist()}
        for frame, pose in enumerate(one.T_world_cam)
    ]
    (folder / "nerfstudio/transforms.json").write_text(json.dumps({"fl_x": 70.0, "frames": frames}))
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1, model="PINHOLE", width=SHAPE[1], height=SHAPE[0], params=[70, 70, 48, 32]
        )
    )
    for frame, pose in enumerate(one.T_world_cam):
        image = pycolmap.Image(name=f"f{frame}.png", camera_id=1, image_id=frame + 1)
        T = np.linalg.inv(pose)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3]))
    for place, write in (("sparse/0", model.write_binary), ("sparse", model.write_text)):
        (folder / "colmap" / place).mkdir(parents=True, exist_ok=True)
        write(folder / "colmap" / place)
    for path in (folder / "colmap/sparse").rglob("*.*"):
        if path.stem not in {"images", "cameras"}:  # the others are not read
            path.unlink()


def images_and_video(folder: Path) -> None:
    (folder / "images").mkdir(parents=True)
    writer = cv2.VideoWriter(
        str(folder / "walk.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, SHAPE[::-1], False
    )
    for frame, image in enumerate(sequence().frames):
        cv2.imwrite(str(folder / f"images/walk_{frame}.png"), image)
        writer.write(image)
    writer.release()
    write_camera(sequence().camera, folder / "camera.yaml")


def evo_results(folder: Path) -> None:
    folder.mkdir()
    errors = np.array([0.1, 0.2, 0.4])
    info = {"title": "APE", "label": "APE (m)", "est_name": "mine", "ref_name": "truth"}
    write_evo_result(folder / "mine.zip", EvoResult(info, statistics(errors), errors))


def tum_mono(folder: Path) -> None:
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(2)
    for frame in range(FRAMES):
        image = rng.integers(0, 256, SHAPE, dtype=np.uint8)
        cv2.imwrite(str(folder / "images" / f"{frame:05d}.png"), image)
    rows = [f"{frame:05d} {100 + frame / 10:.6f} 4.5" for frame in range(FRAMES)]
    (folder / "times.txt").write_text("\n".join(rows) + "\n")
    height, width = SHAPE
    (folder / "camera.txt").write_text(
        f"0.535719 0.669566 0.493248 0.500408 0.897966\n{width} {height}\ncrop\n{width} {height}\n"
    )
    (folder / "pcalib.txt").write_text(" ".join(f"{level**1.1:.6f}" for level in range(256)) + "\n")
    cv2.imwrite(str(folder / "vignette.png"), np.full(SHAPE, 65535, np.uint16))
    poses = [f"{100 + frame / 10:.6f} 0 0 {frame / 10} 0 0 0 1" for frame in range(FRAMES)]
    (folder / "groundtruthSync.txt").write_text("\n".join(poses) + "\n")


def tum_mono_zip(folder: Path) -> None:
    tum_mono(folder)
    with zipfile.ZipFile(folder / "images.zip", "w") as archive:
        for path in sorted((folder / "images").iterdir()):
            archive.write(path, path.name)
    shutil.rmtree(folder / "images")
