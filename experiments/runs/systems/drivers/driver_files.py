"""What drivers of other people's systems read and write; they run apart, without a package of ours."""

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np


class Frames:
    """The frames of a TUM-form folder.

    Args:
        folder: with rgb.txt, camera.yaml and the images.
        speed: 1 to give them at the pace of their stamps, 0 as fast as they are taken.

    Attributes:
        camera: keys and values of camera.yaml, numbers but for ``model``.
    """

    def __init__(self, folder: Path, speed: float) -> None:
        rows = [line.split() for line in (folder / "rgb.txt").read_text().splitlines()]
        self._rows = [(float(row[0]), folder / row[1]) for row in rows if row and not row[0].startswith("#")]
        self._speed = speed
        self.camera = _read_camera(folder / "camera.yaml")

    def __iter__(self) -> Iterator[tuple[float, np.ndarray]]:
        """Yield stamp_s and image (H, W) uint8, none before it is due."""
        started_s, first_s = time.perf_counter(), self._rows[0][0] if self._rows else 0.0
        for stamp_s, path in self._rows:
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if image is None:
                raise OSError(f"{path} cannot be read")
            if self._speed > 0:
                due_s = started_s + (stamp_s - first_s) / self._speed
                time.sleep(max(0.0, due_s - time.perf_counter()))
            yield stamp_s, image


class Log:
    """Rows of frames.csv and poses as they were given, written as they come: a crash loses nothing.

    Args:
        out: folder to write into.
        poses: name of the file of poses.
        more: names of further columns of frames.csv.
    """

    def __init__(self, out: Path, poses: str, *more: str) -> None:
        self._frames = (out / "frames.csv").open("w", buffering=1)
        self._frames.write(",".join(["stamp_s,state,ms,cpu_ms", *more]) + "\n")
        self._poses = (out / poses).open("w", buffering=1)

    def frame(self, stamp_s: float, state: str, ms: float, cpu_ms: float, *more: float) -> None:
        """Write the row of a frame: state in the system's words, wall and CPU milliseconds of the call."""
        numbers = ",".join(f"{n:.3f}" if isinstance(n, float) else str(n) for n in (ms, cpu_ms, *more))
        self._frames.write(f"{stamp_s:.9f},{state},{numbers}\n")

    def pose(self, stamp_s: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """Write the pose of a frame, camera to map."""
        self._poses.write(pose_line(stamp_s, position, quat_xyzw))

    def close(self) -> None:
        """Close the files."""
        self._frames.close()
        self._poses.close()


class Clock:
    """Wall and CPU time of a call in this thread, milliseconds."""

    def __enter__(self) -> "Clock":
        self._started_s, self._started_cpu_s = time.perf_counter(), time.thread_time()
        return self

    def __exit__(self, *_: object) -> None:
        self.ms = 1e3 * (time.perf_counter() - self._started_s)
        self.cpu_ms = 1e3 * (time.thread_time() - self._started_cpu_s)


def pose_line(stamp_s: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> str:
    """A line of TUM's form."""
    return " ".join([f"{stamp_s:.9f}", *(repr(float(value)) for value in (*position, *quat_xyzw))]) + "\n"


def quaternion_xyzw(R: np.ndarray) -> list[float]:
    """Unit quaternion of a (3, 3) rotation.

    Source: Shepperd, "Quaternion from rotation matrix", 1978: divide by the largest of the four.
    """
    trace = float(np.trace(R))
    squares = [*(1 + 2 * float(R[i, i]) - trace for i in range(3)), 1 + trace]
    largest = int(np.argmax(squares))
    if largest == 3:
        rest = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
        quat = np.array([*rest, squares[3]])
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        quat = np.zeros(4)
        quat[i], quat[j], quat[k] = squares[i], R[j, i] + R[i, j], R[k, i] + R[i, k]
        quat[3] = R[k, j] - R[j, k]
    return (quat / (2 * math.sqrt(squares[largest]))).tolist()


def _read_camera(path: Path) -> dict:
    pairs = (line.partition("#")[0].partition(":") for line in path.read_text().splitlines())
    found = {key.strip(): value.strip().strip("'\"") for key, _, value in pairs if value.strip()}
    return {key: value if key == "model" else float(value) for key, value in found.items()}
