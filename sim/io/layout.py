"""The TUM-form folder: names of its files and its conventions.

    rgb/000000.png ...   gray or colour images
    rgb.txt              stamp and image path per frame
    camera.yaml          fx fy cx cy width height fps model, and the coefficients of the lens model:
                         radtan k1 k2 p1 p2 k3, equidistant k1 k2 k3 k4
    groundtruth.txt      stamp tx ty tz qx qy qz qw: camera (x right, y down, z forward) to world
    depth/, depth.txt    16-bit images, 5000 per metre, 0 for none or beyond 13.1 m
    segments.json, frame_truth.csv, meta.json   of simulated sequences, in every form

All but the images, ``rgb.txt`` and ``camera.yaml`` may be absent.
"""

FRAMES_FILE = "rgb.txt"
CAMERA_FILE = "camera.yaml"
CALIBRATION_FILE = "calibration.yaml"
TRUTH_FILE = "groundtruth.txt"
DEPTH_FILE = "depth.txt"
SEGMENTS_FILE = "segments.json"
FRAME_TRUTH_FILE = "frame_truth.csv"
META_FILE = "meta.json"

CAMERA_KEYS = ("fx", "fy", "cx", "cy", "width", "height", "fps")
DEPTH_PER_M = 5000.0
