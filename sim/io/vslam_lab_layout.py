"""The VSLAM-LAB form: names of its files, its columns and its lenses.

    rgb_0/              images of the first camera, gray or colour
    rgb.csv             `ts_rgb_0 (ns),path_rgb_0`: stamp in nanoseconds and image path of each frame;
                        columns of other cameras and of depth, `ts_depth_0 (ns),path_depth_0`, may follow
    calibration.yaml    under `cameras` an entry with `cam_name: rgb_0` and its focal_length, principal_point,
                        image_dimension and fps; distortion_type and distortion_coefficients of a lens with
                        distortion; depth_factor, codes per metre, where there are depth images
    groundtruth.csv     `ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw`: pose of that camera in the world

``groundtruth.csv`` may be absent or hold its header only. ``T_BS``, the place of a camera on its body, is not
used: true poses are the camera's. Source: github.com/VSLAM-LAB/VSLAM-LAB.
"""

from typing import Literal

IMAGES_DIR, FRAMES_FILE = "rgb_0", "rgb.csv"
CALIBRATION_FILE, TRUTH_FILE = "calibration.yaml", "groundtruth.csv"
DEPTH_DIR = "depth_0"

STAMP, PATH, DEPTH_PATH = "ts_rgb_0 (ns)", "path_rgb_0", "path_depth_0"
DEPTH_STAMP = "ts_depth_0 (ns)"
POSE_COLUMNS = ["ts (ns)", "tx (m)", "ty (m)", "tz (m)", "qx", "qy", "qz", "qw"]

LENSES: dict[str, tuple[Literal["radtan", "equidistant"], int]] = {
    "radtan4": ("radtan", 4),
    "radtan5": ("radtan", 5),
    "equid4": ("equidistant", 4),
}
"""Lens model and number of coefficients of each ``distortion_type``."""
