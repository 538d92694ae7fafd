"""Export of maps as a COLMAP model and a point cloud."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dslab.slam.colmap import pycolmap
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.map.map import Map

# COLMAP's pixel coordinates start at the corner of a pixel, ours at its centre.
_HALF_PX = 0.5


def colmap_model(
    map_: Map,
    camera: PinholeCamera,
    *,
    image_name: Callable[[int], str] = "{:06d}.png".format,
    image: Callable[[int], np.ndarray] | None = None,
) -> pycolmap.Reconstruction:
    """Convert a map to a COLMAP reconstruction with all keyframes, keypoints and points.

    Image ids are keyframe rows + 1 and point ids are point rows + 1; keypoints are those of the distorted
    input images, and the camera has the distortion. World is the map's frame and scale.

    Args:
        map_: left unchanged.
        camera: camera of the images.
        image_name: file name of a frame by its index.
        image: (H, W) uint8 image of a frame by its index, for the points' grey levels; None for mid grey.
    """
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(_camera(camera))
    a = map_.arrays
    for k in map_.keyframes():
        features = map_.features(int(k))
        T = a.kf_T_cam_map[k]
        picture = pycolmap.Image(
            name=image_name(features.index),
            keypoints=features.xy_image.astype(np.float64) + _HALF_PX,
            camera_id=1,
            image_id=int(k) + 1,
        )
        model.add_image_with_trivial_frame(
            picture, pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3])
        )
    rows = np.flatnonzero(a.kp_point[: a.kf_start[map_.n_keyframes]] >= 0)
    rows = rows[np.argsort(a.kp_point[rows], kind="stable")]
    shades = _shades(map_, rows, image)
    points, first = np.unique(a.kp_point[rows], return_index=True)
    for p, observers in zip(points, np.split(rows, first[1:]), strict=True):
        model.add_point3D_with_id(int(p) + 1, _point(map_, int(p), observers, shades))
    model.update_point_3d_errors()
    return model


def write_colmap(model: pycolmap.Reconstruction, folder: Path) -> None:
    """Write cameras, images and points in COLMAP's binary format, and points.ply."""
    folder.mkdir(parents=True, exist_ok=True)
    model.write(folder)
    model.export_PLY(folder / "points.ply")


def _camera(camera: PinholeCamera) -> pycolmap.Camera:
    focal = [camera.fx, camera.fy, camera.cx + _HALF_PX, camera.cy + _HALF_PX]
    if camera.model == "equidistant":
        model, params = "OPENCV_FISHEYE", [*focal, *camera.distortion]
    elif not any(camera.distortion) and not any(camera.residual):
        model, params = "PINHOLE", focal
    elif camera.distortion[4] == 0:
        model, params = "OPENCV", [*focal, *_coefficients(camera)]
    else:
        model, params = "FULL_OPENCV", [*focal, *_coefficients(camera), camera.distortion[4], 0.0, 0.0, 0.0]
    return pycolmap.Camera(
        camera_id=1, model=model, width=camera.width_px, height=camera.height_px, params=params
    )


def _coefficients(camera: PinholeCamera) -> list[float]:
    """First coefficients of the lens, residual distortion included: exact if there is no other."""
    return [own + left for own, left in zip(camera.distortion, camera.residual, strict=False)]


def _point(map_: Map, point: int, rows: np.ndarray, shades: np.ndarray) -> pycolmap.Point3D:
    """One point with its track; ``rows`` are the keypoints that observe it."""
    a = map_.arrays
    track = pycolmap.Track()
    for row in rows:
        k = int(a.kp_keyframe[row])
        track.add_element(k + 1, int(row - a.kf_start[k]))
    return pycolmap.Point3D(xyz=a.pt_xyz[point], track=track, color=np.full(3, shades[point], np.uint8))


def _shades(map_: Map, rows: np.ndarray, image: Callable[[int], np.ndarray] | None) -> np.ndarray:
    """(n_points,) uint8 mean grey level of each point's keypoints in the keyframes' images."""
    total, count = np.zeros(map_.n_points), np.zeros(map_.n_points)
    if image is not None:
        of_row = map_.arrays.kp_keyframe[rows]
        for k in np.unique(of_row):
            mine = rows[of_row == k]
            features = map_.features(int(k))
            x, y = np.rint(features.xy_image[mine - map_.arrays.kf_start[k]]).astype(int).T
            points = map_.arrays.kp_point[mine]
            np.add.at(total, points, image(features.index)[y, x])
            np.add.at(count, points, 1)
    return np.where(count > 0, total / np.maximum(count, 1), 128).astype(np.uint8)
