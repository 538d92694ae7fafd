"""ORB-SLAM3's settings beside a written sequence: its own programs then run on the folder at once.

Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, Sec. V-A: 8 levels with a factor of 1.2, 1000 corners up
to 752x480 pixels, 2000 in the larger images of KITTI. FAST's thresholds and the viewer's numbers are those of
ORB-SLAM3's published settings.
"""

from pathlib import Path

from dslab.sim.sensors.camera import DISTORTION_KEYS, Intrinsics

SETTINGS_FILE, TIMES_FILE = "orbslam3.yaml", "orbslam3_times.txt"
_LENSES = {"radtan": "PinHole", "equidistant": "KannalaBrandt8"}
_EXTRACTOR = {"scaleFactor": 1.2, "nLevels": 8, "iniThFAST": 20, "minThFAST": 7}
_FEATURES, _FEATURES_WIDE, _WIDE_PX = 1000, 2000, 752 * 480
# Read at the start even where nothing is shown.
_VIEWER = {
    "KeyFrameSize": 0.05, "KeyFrameLineWidth": 1.0, "GraphLineWidth": 0.9, "PointSize": 2.0,
    "CameraSize": 0.08, "CameraLineWidth": 3.0, "ViewpointX": 0.0, "ViewpointY": -0.7, "ViewpointZ": -1.8,
    "ViewpointF": 500.0, "imageViewScale": 1.0,
}  # fmt: skip


def write_orbslam3_settings(camera: Intrinsics, folder: Path) -> None:
    """Write the settings, but for the rational lens model, which ORB-SLAM3 lacks."""
    if camera.model in _LENSES:
        (folder / SETTINGS_FILE).write_text(orbslam3_settings(camera))


def orbslam3_settings(camera: Intrinsics) -> str:
    """The settings of monocular ORB-SLAM3, in version 1.0 of their form.

    Args:
        camera: of the model ``radtan`` or ``equidistant``. The features are those of ORB-SLAM3's own settings
            for images of about its size.
    """
    lens = dict(zip(DISTORTION_KEYS[camera.model], camera.distortion, strict=True))
    if camera.model == "radtan" and lens["k3"] == 0:
        del lens["k3"]
    numbers = {key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy")} | lens
    wide = camera.width_px * camera.height_px > _WIDE_PX
    lines = ["%YAML:1.0", 'File.version: "1.0"', f'Camera.type: "{_LENSES[camera.model]}"']
    lines += [f"Camera1.{key}: {float(value)!r}" for key, value in numbers.items()]
    lines += [f"Camera.width: {camera.width_px}", f"Camera.height: {camera.height_px}"]
    lines += [f"Camera.fps: {max(1, round(camera.fps))}", "Camera.RGB: 0"]
    lines += [f"ORBextractor.nFeatures: {_FEATURES_WIDE if wide else _FEATURES}"]
    lines += [f"ORBextractor.{key}: {value}" for key, value in _EXTRACTOR.items()]
    lines += [f"Viewer.{key}: {value}" for key, value in _VIEWER.items()]
    return "\n".join(lines) + "\n"
