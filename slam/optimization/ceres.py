"""Bundle adjustment by Ceres through pycolmap, in this process or in a separate one.

COLMAP has one variance for all keypoints of a camera. The pyramid levels have different ones, so every
keyframe is a rig of one pinhole per level, all at the same pose, whose unit is that level's sigma:
reprojection errors are then in sigma, as in local bundle adjustment.

The solver holds Python's global interpreter lock, and the pycolmap function that releases it prints a
headline on every call. Callers that must not wait therefore run it as ``python -m`` this module.
"""

import io
import subprocess
import sys

import numpy as np

from dslab.slam.colmap import pycolmap

HUBER_DELTA = 5.991**0.5


def solve(
    T_cam_map: np.ndarray,
    points: np.ndarray,
    obs_cam: np.ndarray,
    obs_point: np.ndarray,
    keypoints: np.ndarray,
    octave: np.ndarray,
    sigma: np.ndarray,
    intrinsics: np.ndarray,
    iterations: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Minimise the Huber loss of the reprojection errors.

    Args:
        T_cam_map: (C, 4, 4) poses.
        points: (P, 3).
        obs_cam, obs_point: (M,) int, every observation in front of its camera.
        keypoints: (M, 2) pixels in units of their sigma.
        octave: (M,) pyramid level.
        sigma: (L,) of each level, px.
        intrinsics: (4,) fx, fy, cx, cy.
        iterations: most steps.

    Returns:
        Poses (C, 4, 4) and points (P, 3), in the frame of the first camera's pose.
    """
    model = _rigs(sigma, *intrinsics)
    observed = _add_frames(model, T_cam_map, obs_cam, keypoints, octave)
    _add_points(model, points, obs_point, observed)
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images:
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(_options(iterations), config, model).solve()
    return _read_back(model, T_cam_map, points)


def solve_apart(*arguments) -> tuple[np.ndarray, np.ndarray]:
    """Run :func:`solve` in a separate process, so that other threads of this one can run.

    Raises:
        RuntimeError: the process has failed; the message is the end of its error output.
    """
    sent = io.BytesIO()
    np.savez(sent, *arguments)
    done = subprocess.run(
        [sys.executable, "-m", __name__], input=sent.getvalue(), capture_output=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"global bundle adjustment has failed: {done.stderr.decode()[-500:]}")
    with np.load(io.BytesIO(done.stdout)) as result:
        return result["arr_0"], result["arr_1"]


def _main() -> None:
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as sent:
        *arrays, iterations = (sent[f"arr_{i}"] for i in range(len(sent.files)))
    np.savez(sys.stdout.buffer, *solve(*arrays, int(iterations)))


def _read_back(
    model: pycolmap.Reconstruction, T_cam_map: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Poses and points, in the frame of the first camera's pose."""
    T, xyz = np.array(T_cam_map, np.float64), np.array(points, np.float64)
    for c in range(len(T)):
        pose = model.frame(c + 1).rig_from_world
        if pose is not None:
            T[c, :3] = pose.matrix()
    home = np.linalg.inv(T_cam_map[0]) @ T[0]
    for p, landmark in model.points3D.items():
        xyz[p - 1] = home[:3, :3] @ landmark.xyz + home[:3, 3]
    return np.concatenate([T_cam_map[:1], T[1:] @ np.linalg.inv(home)]), xyz


def _sensor(level: int) -> pycolmap.sensor_t:
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, level + 1)


def _rigs(sigma: np.ndarray, fx: float, fy: float, cx: float, cy: float) -> pycolmap.Reconstruction:
    """Empty model with one rig: a pinhole per level, all at its origin."""
    model = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    for level, unit in enumerate(sigma):
        size = int(np.ceil(2 * max(cx, cy) / unit))
        model.add_camera(
            pycolmap.Camera(
                camera_id=level + 1,
                model="PINHOLE",
                width=size,
                height=size,
                params=[fx / unit, fy / unit, cx / unit, cy / unit],
            )
        )
        if level:
            rig.add_sensor(_sensor(level), pycolmap.Rigid3d())
        else:
            rig.add_ref_sensor(_sensor(level))
    model.add_rig(rig)
    return model


def _add_frames(
    model: pycolmap.Reconstruction,
    T_cam_map: np.ndarray,
    obs_cam: np.ndarray,
    keypoints: np.ndarray,
    octave: np.ndarray,
) -> np.ndarray:
    """Add every camera with an image per level that it uses.

    Returns:
        (M, 2) int image and keypoint number of each observation.
    """
    levels = model.num_cameras()
    where = np.empty((len(obs_cam), 2), int)
    image_of = obs_cam * levels + octave + 1
    order = np.argsort(image_of, kind="stable")
    ids, first = np.unique(image_of[order], return_index=True)
    pictures: dict[int, list[pycolmap.Image]] = {c: [] for c in range(len(T_cam_map))}
    for i, rows in zip(ids, np.split(order, first[1:]), strict=True):
        where[rows, 0], where[rows, 1] = i, np.arange(len(rows))
        c, level = divmod(int(i) - 1, levels)
        pictures[c].append(
            pycolmap.Image(name=str(i), keypoints=keypoints[rows], camera_id=level + 1, image_id=int(i))
        )
    for c, T in enumerate(T_cam_map):
        frame = pycolmap.Frame(frame_id=c + 1, rig_id=1)
        for picture in pictures[c]:
            frame.add_data_id(picture.data_id)
        frame.rig_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3])
        model.add_frame(frame)
        for picture in pictures[c]:
            picture.frame_id = c + 1
            model.add_image(picture)
        model.register_frame(c + 1)
    return where


def _add_points(
    model: pycolmap.Reconstruction, points: np.ndarray, obs_point: np.ndarray, where: np.ndarray
) -> None:
    order = np.argsort(obs_point, kind="stable")
    seen, first = np.unique(obs_point[order], return_index=True)
    for p, rows in zip(seen, np.split(order, first[1:]), strict=True):
        track = pycolmap.Track()
        for image, keypoint in where[rows]:
            track.add_element(int(image), int(keypoint))
        model.add_point3D_with_id(int(p) + 1, pycolmap.Point3D(xyz=points[p], track=track))


def _options(iterations: int) -> pycolmap.BundleAdjustmentOptions:
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=False,
        refine_principal_point=False,
        refine_extra_params=False,
        refine_sensor_from_rig=False,
        print_summary=False,
    )
    options.ceres.loss_function_type = pycolmap.LossFunctionType.HUBER
    options.ceres.loss_function_scale = HUBER_DELTA
    options.ceres.auto_select_solver_type = False
    solver = options.ceres.solver_options
    solver.max_num_iterations = iterations
    solver.num_threads = 1
    solver.linear_solver_type = type(solver.linear_solver_type).SPARSE_SCHUR
    return options


if __name__ == "__main__":
    _main()
