"""The store of a batch with the results of its runs, and calibrations as people have them."""

import json
import os
from pathlib import Path
from unittest.mock import patch

from hostile_sequences import tum
from pool_fakes import open_local_pool

from dslab.experiments.batch import run as batch_run
from dslab.experiments.batch.spec import read_batch

_MATRIX = "{rows: 3, cols: 3, data: [70.0, 0, 47.5, 0, 70.0, 31.5, 0, 0, 1]}"
_XML = """<?xml version="1.0"?>
<opencv_storage><image_width>96</image_width><image_height>64</image_height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>70.0 0 47.5 0 70.0 31.5 0 0 1</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
<data>0.1 -0.05 0.001 0.002 0.01</data></Distortion_Coefficients></opencv_storage>
"""
_CALIBRATIONS = {
    "opencv.yaml": "image_width: 96\nimage_height: 64\n"
    f"camera_matrix: {_MATRIX}\ndistortion_coefficients: {{rows: 1, cols: 5, data: [0.1, 0.05, 0, 0, 0]}}\n",
    "opencv.xml": _XML,
    "ros.yaml": "width: 96\nheight: 64\ndistortion_model: plumb_bob\n"
    "K: [70.0, 0, 47.5, 0, 70.0, 31.5, 0, 0, 1]\nD: [0.1, 0.05, 0.0, 0.0, 0.0]\n",
    "camchain.yaml": "cam0:\n  camera_model: pinhole\n  distortion_model: equidistant\n"
    "  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]\n  intrinsics: [70.0, 70.0, 47.5, 31.5]\n"
    "  resolution: [96, 64]\n",
    "orb.yaml": "Camera.type: PinHole\nCamera.fx: 70.0\nCamera.fy: 70.0\nCamera.cx: 47.5\nCamera.cy: 31.5\n"
    "Camera.k1: 0.1\nCamera.k2: 0.05\nCamera.p1: 0.0\nCamera.p2: 0.0\n"
    "Camera.width: 96\nCamera.height: 64\nCamera.fps: 10\n",
    "cameras.txt": "1 OPENCV 96 64 70.0 70.0 48.0 32.0 0.1 0.05 0.001 0.002\n",
    "transforms.json": json.dumps(
        {"w": 96, "h": 64, "fl_x": 70.0, "fl_y": 70.0, "cx": 48.0, "cy": 32.0, "k1": 0.1, "frames": []}
    ),
    "camera.txt": "0.7 1.1 0.5 0.5 0.9\n96 64\ncrop\n96 64\n",
}


def calibrations(folder: Path) -> None:
    folder.mkdir(parents=True)
    for name, text in _CALIBRATIONS.items():
        (folder / name).write_text(text)


def batch(folder: Path) -> None:
    """A batch whose runs have all ended; its sequence goes by its name below the folder's parent."""
    folder.mkdir(parents=True)
    tum(folder / "tum")
    write_batch(folder)
    before = Path.cwd()
    os.chdir(folder.parent)
    try:
        spec, sources = read_batch(folder / "batch.yaml")
        with patch.object(batch_run, "open_pool", open_local_pool):
            batch_run.run_batch(spec, sources, folder / "batch")
    finally:
        os.chdir(before)


def write_batch(folder: Path) -> None:
    """Write what a batch is of: the sequence ``tum`` in the same folder."""
    (folder / "batch.yaml").write_text(f"sequences: [{folder.name}/tum]\nsystems: [base]\nruns: 2\n")
