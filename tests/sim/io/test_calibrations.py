"""Calibrations as people have them, each read to the same camera."""

from dataclasses import astuple
from pathlib import Path

import cv2
import numpy as np
import pytest

from dslab.scenarios.errors import InputError
from dslab.sim.io.calibration import fov_lens
from dslab.sim.io.camera_file import read_camera, write_camera
from dslab.sim.io.fov_camera import FovCamera
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import project, unproject
from dslab.slam.core.camera import PinholeCamera

RADTAN = Intrinsics(752, 480, 458.5, 457.25, 367.25, 248.5, 20.0, (-0.28, 0.07, 0.0002, 0.00002, 0.0))
FIVE = Intrinsics(752, 480, 458.5, 457.25, 367.25, 248.5, 20.0, (-0.28, 0.07, 0.0002, 0.00002, 0.002))
FISH = Intrinsics(
    512, 512, 290.5, 290.25, 254.5, 256.5, 20.0, (0.0034, 0.0007, -0.002, 0.0002), "equidistant"
)
RATIONAL = Intrinsics(
    752, 480, 458.5, 457.25, 367.25, 248.5, 20.0,
    (0.5, 0.1, 0.0002, 0.00002, 0.01, 0.8, 0.2, 0.02), "rational",
)  # fmt: skip
PLAIN = Intrinsics(1241, 376, 718.856, 718.856, 607.1928, 185.2157, 10.0)


def matrix(tag, rows, cols, data):
    return f"{tag}\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: {list(data)}\n"


def opencv(camera, tag="!!opencv-matrix"):
    c, dist = camera, camera.distortion
    return (
        f"%YAML:1.0\n---\nimage_width: {c.width_px}\nimage_height: {c.height_px}\n"
        + matrix(f"camera_matrix: {tag}", 3, 3, [c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1])
        + matrix(f"distortion_coefficients: {tag}", len(dist), 1, dist)
        + ("fisheye_model: 1\n" if c.model == "equidistant" else "")
    )


def opencv_xml(camera):
    c = camera
    K = f"{c.fx} 0 {c.cx} 0 {c.fy} {c.cy} 0 0 1"
    dist = " ".join(map(str, c.distortion))
    return (
        f'<?xml version="1.0"?>\n<opencv_storage>\n<image_width>{c.width_px}</image_width>'
        f"<image_height>{c.height_px}</image_height>"
        '<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>'
        f"<data>{K}</data></Camera_Matrix>"
        f'<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt><data>{dist}'
        f"</data></Distortion_Coefficients>\n</opencv_storage>\n"
    )


def ros(camera, model, keys="camera_matrix distortion_coefficients"):
    c, (K, D) = camera, keys.split()
    size = "image_width: {}\nimage_height: {}\n" if K == "camera_matrix" else "width: {}\nheight: {}\n"
    data = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]
    both = (
        f"{K}:\n  rows: 3\n  cols: 3\n  data: {data}\n"
        f"{D}:\n  rows: 1\n  cols: 5\n  data: {list(c.distortion)}\n"
        if K == "camera_matrix"
        else f"{K}: {data}\n{D}: {list(c.distortion)}\n"
    )
    return size.format(c.width_px, c.height_px) + f"camera_name: left\ndistortion_model: {model}\n" + both


def kalibr(camera, lens, coefficients):
    c = camera
    other = "cam1:\n  camera_model: pinhole\n  intrinsics: [1, 1, 1, 1]\n  resolution: [9, 9]\n"
    return (
        f"cam0:\n  camera_model: pinhole\n  distortion_model: {lens}\n"
        f"  distortion_coeffs: {list(coefficients)}\n"
        f"  intrinsics: [{c.fx}, {c.fy}, {c.cx}, {c.cy}]\n  resolution: [{c.width_px}, {c.height_px}]\n"
        f"  rostopic: /cam0\n{other}"
    )


def by_keys(camera, prefix, kind, size="width height", fps="fps"):
    c, names = (
        camera,
        ("k1", "k2", "k3", "k4") if camera.model == "equidistant" else ("k1", "k2", "p1", "p2", "k3"),
    )
    general = "Camera." if prefix.startswith("Camera") else prefix
    wide, high = size.split()
    rows = {"fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, **dict(zip(names, c.distortion, strict=True))}
    lines = [f"{prefix}{key}: {value}" for key, value in rows.items()]
    lines += [f"{general}{wide}: {c.width_px}", f"{general}{high}: {c.height_px}", f"{general}{fps}: {c.fps}"]
    return "\n".join([kind, *lines]) + "\n"


def vins(camera):
    c, (k1, k2, p1, p2) = camera, camera.distortion[:4]
    return (
        "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: camera\n"
        f"image_width: {c.width_px}\nimage_height: {c.height_px}\ndistortion_parameters:\n"
        f"   k1: {k1}\n   k2: {k2}\n   p1: {p1}\n   p2: {p2}\n"
        f"projection_parameters:\n   fx: {c.fx}\n   fy: {c.fy}\n   cx: {c.cx}\n   cy: {c.cy}\n"
    )


def vins_fisheye(camera):
    c, k = camera, camera.distortion
    rows = dict(
        zip(("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0"), (*k, c.fx, c.fy, c.cx, c.cy), strict=True)
    )
    inside = "".join(f"   {key}: {value}\n" for key, value in rows.items())
    return (
        "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\n"
        f"image_width: {c.width_px}\nimage_height: {c.height_px}\n"
        f"projection_parameters:\n{inside}"
    )


def colmap(camera, model, *parameters):
    c = camera
    values = [c.fx, c.fy, c.cx + 0.5, c.cy + 0.5, *parameters]
    words = " ".join(map(str, values))
    return f"# Camera list\n#   CAMERA_ID, MODEL, ...\n1 {model} {c.width_px} {c.height_px} {words}\n"


def transforms(camera):
    c, (k1, k2, p1, p2, k3) = camera, camera.distortion
    return (
        f'{{"camera_model": "OPENCV", "fl_x": {c.fx}, "fl_y": {c.fy}, "cx": {c.cx + 0.5}, "cy": {c.cy + 0.5},'
        f' "w": {c.width_px}, "h": {c.height_px}, "k1": {k1}, "k2": {k2}, "p1": {p1}, "p2": {p2}, "k3": {k3},'
        ' "frames": [{"file_path": "images/1.png"}]}'
    )


def dso(camera, name, *lens, relative=True):
    c = camera
    four = (c.fx / c.width_px, c.fy / c.height_px, (c.cx + 0.5) / c.width_px, (c.cy + 0.5) / c.height_px)
    values = four if relative else (c.fx, c.fy, c.cx, c.cy)
    words = " ".join(map(repr, (*values, *lens)))
    return f"{name} {words}\n{c.width_px} {c.height_px}\ncrop\n640 480\n".lstrip()


def euroc(camera):
    c = camera
    return (
        "%YAML:1.0\nsensor_type: camera\nT_BS:\n  rows: 4\n  cols: 4\n"
        f"  data: {np.eye(4).ravel().tolist()}\n"
        f"rate_hz: {c.fps:g}\nresolution: [{c.width_px}, {c.height_px}]\n"
        f"camera_model: pinhole\nintrinsics: [{c.fx}, {c.fy}, {c.cx}, {c.cy}]\n"
        f"distortion_model: radial-tangential\ndistortion_coefficients: {list(c.distortion[:4])}\n"
    )


KITTI = (
    "P0: 7.188560000000e+02 0 6.071928000000e+02 0 0 7.188560000000e+02 1.852157000000e+02 0 0 0 1 0\n"
    "P2: 7.1e+02 0 6.0e+02 4.5e+01 0 7.1e+02 1.8e+02 -1.1e-01 0 0 1 4.9e-03\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n"
)
RAW = (
    "calib_time: 09-Jan-2012 13:57:47\nS_rect_00: 1.241000e+03 3.760000e+02\n"
    "P_rect_00: 7.188560e+02 0 6.071928e+02 0 0 7.188560e+02 1.852157e+02 0 0 0 1 0\n"
)
FILES = {
    "opencv.yaml": (opencv(FIVE), FIVE),
    "opencv.xml": (opencv_xml(FIVE), FIVE),
    "opencv-fisheye.yml": (opencv(FISH), FISH),
    "opencv-eight.yml": (opencv(RATIONAL), RATIONAL),
    "camera_info.yaml": (ros(FIVE, "plumb_bob"), FIVE),
    "camera_info-eight.yaml": (ros(RATIONAL, "rational_polynomial"), RATIONAL),
    "camera_info-topic.yaml": (ros(FISH, "equidistant", "K D"), FISH),
    "camera_info-topic2.yaml": (ros(FIVE, "plumb_bob", "k d"), FIVE),
    "camchain.yaml": (kalibr(RADTAN, "radtan", RADTAN.distortion[:4]), RADTAN),
    "camchain-fisheye.yaml": (kalibr(FISH, "equidistant", FISH.distortion), FISH),
    "camchain.yaml:cam0": (kalibr(RADTAN, "radtan", RADTAN.distortion[:4]), RADTAN),
    "EuRoC.yaml": ("%YAML:1.0\n" + by_keys(FIVE, "Camera.", 'Camera.type: "PinHole"'), FIVE),
    "EuRoC-v1.yaml": ("%YAML:1.0\n" + by_keys(FIVE, "Camera1.", 'Camera.type: "PinHole"'), FIVE),
    "TUM-VI.yaml": ("%YAML:1.0\n" + by_keys(FISH, "Camera1.", 'Camera.type: "KannalaBrandt8"'), FISH),
    "stella.yaml": (by_keys(FIVE, "  ", 'Camera:\n  name: "x"\n  model: "perspective"', "cols rows"), FIVE),
    "stella-fisheye.yaml": (by_keys(FISH, "  ", 'Camera:\n  model: "fisheye"', "cols rows"), FISH),
    "vins.yaml": (vins(RADTAN), RADTAN),
    "vins-fisheye.yaml": (vins_fisheye(FISH), FISH),
    "cameras.txt": (colmap(RADTAN, "OPENCV", *RADTAN.distortion[:4]), RADTAN),
    "cameras.txt:1": (colmap(FISH, "OPENCV_FISHEYE", *FISH.distortion), FISH),
    "cameras-full.txt": (colmap(RATIONAL, "FULL_OPENCV", *RATIONAL.distortion), RATIONAL),
    "transforms.json": (transforms(FIVE), FIVE),
    "camera-pinhole.txt": (dso(PLAIN, "Pinhole", 0), PLAIN),
    "camera-pixels.txt": (dso(PLAIN, "", 0, relative=False), PLAIN),
    "camera-radtan.txt": (dso(RADTAN, "RadTan", *RADTAN.distortion[:4]), RADTAN),
    "camera-fish.txt": (dso(FISH, "EquiDistant", *FISH.distortion), FISH),
    "sensor.yaml": (euroc(RADTAN), RADTAN),
    "calib.txt": (KITTI, PLAIN),
    "calib_cam_to_cam.txt:00": (RAW, PLAIN),
    "with-mark.yaml": ("\ufeff" + opencv(FIVE), FIVE),
}


@pytest.mark.parametrize("name", FILES)
def test_every_form_gives_its_camera(name, tmp_path):
    text, camera = FILES[name]
    (tmp_path / name.partition(":")[0]).write_text(text, encoding="utf-8")
    size, fps = (camera.width_px, camera.height_px), camera.fps
    read = read_camera(tmp_path / name, size, fps)
    assert read.model == camera.model
    assert astuple(read)[:7] == pytest.approx(astuple(camera)[:7])
    assert read.distortion == pytest.approx(camera.distortion)
    write_camera(read, tmp_path / "camera.yaml")
    assert read_camera(tmp_path / "camera.yaml") == read


def test_a_suffix_names_the_camera(tmp_path):
    (tmp_path / "calib.txt").write_text(KITTI)
    assert read_camera(tmp_path / "calib.txt:P2", (1241, 376)).fx == 710
    with pytest.raises(InputError, match=r"P7: is missing.*it has P0, P2"):
        read_camera(tmp_path / "calib.txt:P7", (1241, 376))


@pytest.mark.parametrize("omega", [0.0, 0.5, 0.93, 1.2])
def test_a_fov_lens_is_an_equidistant_one(omega, tmp_path):
    fov = FovCamera(640, 480, 420.0, 422.0, 310.0, 245.0, omega)
    camera = Intrinsics(640, 480, **_fields(fov_lens((420.0, 422.0), (310.0, 245.0), (640, 480), omega)))
    xy = np.stack(np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7)), -1).reshape(-1, 2)
    assert np.abs(project(camera, fov.unproject(xy)) - xy).max() < 0.05
    (tmp_path / "camera.txt").write_text(
        dso(Intrinsics(640, 480, 420.0, 422.0, 310.0, 245.0, 30), "FOV", omega)
    )
    read = read_camera(tmp_path / "camera.txt", fps=30.0)
    assert astuple(read)[:7] == pytest.approx(astuple(camera)[:7])
    assert read.distortion == pytest.approx(camera.distortion, abs=1e-9)


def _fields(lens):
    (fx, fy), (cx, cy) = lens["focal_px"], lens["centre_px"]
    rest = {key: lens[key] for key in ("model", "distortion") if key in lens}
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "fps": 30.0} | rest


@pytest.mark.parametrize("camera", [FIVE, RATIONAL, FISH], ids=lambda camera: camera.model)
def test_every_lens_is_undone(camera):
    """In the simulator, and in the SLAM, by OpenCV's projection."""
    xy = np.stack(
        np.meshgrid(np.linspace(0, camera.width_px - 1, 9), np.linspace(0, camera.height_px - 1, 7)), -1
    )
    xy = xy.reshape(-1, 2)
    rays = unproject(camera, xy)
    points = np.column_stack([rays, np.ones(len(rays))])[:, None]
    taken = (cv2.fisheye if camera.model == "equidistant" else cv2).projectPoints(
        points, np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )[0][:, 0]
    assert np.abs(taken - xy).max() < 1e-6
    slam = PinholeCamera(*astuple(camera))
    ideal = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    assert np.abs(slam.undistort_points(xy.astype(np.float32)) - ideal).max() < 0.05


KALIBR, TWO = kalibr(RADTAN, "none", []), colmap(PLAIN, "PINHOLE")
FAULTS = {
    "unified": ("camchain.yaml", KALIBR.replace("pinhole", "omni", 1), "'omni', the unified (MEI) model"),
    "double sphere": ("camchain.yaml", KALIBR.replace("pinhole", "ds", 1), "the double sphere model, is not"),
    "MEI": ("vins.yaml", vins(RADTAN).replace("PINHOLE", "MEI"), "'MEI', the unified (MEI) model"),
    "prism": ("cameras.txt", colmap(RADTAN, "THIN_PRISM_FISHEYE", *[0] * 8), "the thin prism model, is not"),
    "two cameras": ("cameras.txt", TWO + "2" + TWO.splitlines()[-1][1:], "holds 2 cameras; add one of 1, 2"),
    "no size": ("TUM1.yaml", by_keys(FIVE, "Camera.", "").replace("width", "w"), "none; write `dslab camera"),
    "no rate": ("opencv.yaml", opencv(FIVE), "fps: a file of the form OpenCV FileStorage has none"),
    "entities": ("o.xml", '<!DOCTYPE x [<!ENTITY a "b">]><opencv_storage/>', "with a document type"),
    "skew": ("o.yaml", opencv(FIVE).replace("458.5, 0,", "458.5, 7,"), "camera_matrix: is no camera matrix"),
    "notes": ("notes.yaml", "a: 1\n", "is no calibration of a known form; give one of"),
    "frames": ("transforms.json", '{"frames": {"a": 1}, "w": 9, "h": 9}', "camera_angle_x: is missing"),
    "lists": ("transforms.json", '{"frames": [{"fl_x": [1]}]}', "fl_x: [1] is not a finite number"),
    "size": ("calib.txt", RAW.replace(" 3.760000e+02", ""), "1 numbers where 2 belong"),
    "many": ("transforms.json", '{"frames": [{"fl_x": 1}, {"fl_x": 2}]}', "cameras of their own"),
}


@pytest.mark.parametrize(("name", "text", "says"), FAULTS.values(), ids=FAULTS)
def test_what_cannot_be_read_is_one_line_with_the_remedy(name, text, says, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as caught:
        read_camera(tmp_path / name)
    assert (
        says in str(caught.value) and str(Path(name)) in str(caught.value) and "\n" not in str(caught.value)
    )


def test_the_command_shows_what_was_read_and_scales_it(dslab, tmp_path):
    (tmp_path / "camchain.yaml").write_text(kalibr(RADTAN, "radtan", RADTAN.distortion[:4]))
    code, out, err = dslab("camera", tmp_path / "camchain.yaml", "--fps", 20, "--scale", "376x240")
    assert (code, err) == (0, "") and out.startswith(f"# {tmp_path}/camchain.yaml, read as Kalibr camchain\n")
    (tmp_path / "camera.yaml").write_text(out)
    read = read_camera(tmp_path / "camera.yaml")
    assert (read.width_px, read.height_px, read.fx, read.cx) == (376, 240, 229.25, (367.25 + 0.5) / 2 - 0.5)
    assert "another shape" in dslab("camera", tmp_path / "camera.yaml", "--scale", "640x480")[2]
    code, out, err = dslab("camera", tmp_path / "camera.yaml", "--scale", "wide")
    assert (code, out, err.count("\n")) == (2, "", 1) and "--scale: 'wide' is no size" in err
