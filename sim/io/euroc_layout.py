"""The EuRoC (ASL) form: names of its files, its columns and its clock.

    mav0/cam0/data.csv          stamp in nanoseconds and file name of each frame
    mav0/cam0/data/*.png        the images
    mav0/cam0/sensor.yaml       intrinsics, distortion, rate, mounting T_BS: camera to body
    mav0/imu0/data.csv          stamp, angular rate, specific force, body frame
    mav0/imu0/sensor.yaml       rate, noise densities
    mav0/state_groundtruth_estimate0/data.csv   stamp, position, quaternion wxyz of the body in the world,
                                and, where known, velocity and the biases of gyro and accelerometer

The body is the inertial sensor; without one it is the camera.

Stamps count from the first frame where they are nanoseconds since 1970, since a float64 of seconds cannot
hold those; ``stamp_origin_ns`` in the sequence's ``meta`` keeps the first frame's.
"""

import numpy as np

from dslab.sim.sequence import Sequence

CAMERA_DIR, IMU_DIR, TRUTH_DIR = "mav0/cam0", "mav0/imu0", "mav0/state_groundtruth_estimate0"
TABLE_FILE, SENSOR_FILE = "data.csv", "sensor.yaml"
ORIGIN_KEY = "stamp_origin_ns"

IMU_COLUMNS = ["timestamp"] + [f"{name}_RS_S_{axis}" for name in "wa" for axis in "xyz"]
POSE_COLUMNS = ["timestamp", "p_x", "p_y", "p_z", "q_w", "q_x", "q_y", "q_z"]
LENS_NAMES = {"radtan": "radial-tangential", "equidistant": "equidistant"}

_NS_PER_S = 1_000_000_000


def origin_ns(sequence: Sequence) -> int:
    """Nanoseconds at 0 s of a sequence."""
    return int(sequence.meta.get(ORIGIN_KEY, 0))


def to_ns(stamps_s: np.ndarray, origin: int) -> list[int]:
    """Whole nanoseconds of stamps in seconds since an origin."""
    return [origin + round(float(stamp_s) * _NS_PER_S) for stamp_s in stamps_s]


def choose_origin_ns(stamps: list[int]) -> int:
    """The first stamp if the last exceeds float64 precision in nanoseconds, else 0."""
    return stamps[0] if stamps[-1] >= 2**53 else 0


def to_seconds(stamps: list[int], origin: int) -> np.ndarray:
    """(M,) float64 seconds since an origin, exact to the nanosecond."""
    return np.array([stamp - origin for stamp in stamps], float) / _NS_PER_S
