"""Writer of an .rrd file: entities, times, write errors."""

import atexit
import ctypes
import errno
import os
import re
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

APPLICATION = "dslab"
_NO_SPACE_BYTES = 1 << 20
_STILL_S = 5.0


class Stream:
    """Writer of entities by path and frame, on the time lines ``frame`` and ``time``.

    Args:
        path: file to write.
        title: name of the recording.
        stamps_s: (N,) float64 times of the frames; those of the file count from the first.

    Raises:
        OSError: the file cannot be written; also from :meth:`close`.
    """

    def __init__(self, path: Path, title: str, stamps_s: np.ndarray) -> None:
        self._path, self._is_stuck = path, False
        self._first_s, self._times_s = stamps_s[0], stamps_s - stamps_s[0]
        self._rec = rr.RecordingStream(APPLICATION, recording_id=title)
        self._rec.set_log_time_enabled(False)
        self._rec.set_log_tick_enabled(False)
        try:
            self._rec.save(path)
        except RuntimeError as error:
            raise self._write_error() from error
        self._rec.send_recording_name(title)

    def close(self, failed: bool) -> None:
        """Close the file; write errors are raised unless the caller has ``failed`` already."""
        try:
            self._flush()
        except RuntimeError as error:
            if not failed:
                raise self._write_error() from error
        finally:
            if not self._is_stuck:
                self._rec.disconnect()

    def _flush(self) -> None:
        """Wait while the file grows: rerun's writer may end at an error without a word, and is waited for."""
        size_bytes = -1
        while True:
            try:
                return self._rec.flush(timeout_sec=_STILL_S)
            except RuntimeError as error:
                before_bytes, size_bytes = size_bytes, self._path.stat().st_size
                if "timed out" not in str(error):
                    raise
                if size_bytes <= before_bytes:
                    self._abandon()
                    raise

    def _abandon(self) -> None:
        """Leave a stream that has no writer: to disconnect or to free it would wait for ever."""
        self._is_stuck = True
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._rec.inner))
        atexit.unregister(rr.rerun_shutdown)

    def static(self, entity: str, *archetypes: Any) -> None:
        """Write data for all times."""
        for archetype in archetypes:
            self._rec.log(entity, archetype, static=True)

    def place(self, frame: int, stamp_s: float) -> None:
        """Give a frame its time: a run numbers the frames that it was fed, which may lack unreadable ones."""
        self._times_s[frame] = stamp_s - self._first_s

    def log(self, entity: str, frame: int, archetype: Any) -> None:
        """Write data from a frame on."""
        self._rec.set_time("frame", sequence=frame)
        self._rec.set_time("time", duration=float(self._times_s[frame]))
        self._rec.log(entity, archetype)

    def columns(self, entity: str, frames: Iterable[int], columns: Any) -> None:
        """Write one row of data per frame."""
        frames = np.asarray(list(frames), int)
        if not len(frames):
            return
        times = [
            rr.TimeColumn("frame", sequence=frames),
            rr.TimeColumn("time", duration=self._times_s[frames]),
        ]
        self._rec.send_columns(entity, times, columns)

    def poses(self, entity: str, frames: Iterable[int], T_world_cam: np.ndarray) -> None:
        """Write (n, 4, 4) poses of an entity, one per frame."""
        quaternions = Rotation.from_matrix(T_world_cam[:, :3, :3]).as_quat() if len(T_world_cam) else []
        self.columns(
            entity,
            frames,
            rr.Transform3D.columns(translation=T_world_cam[:, :3, 3], quaternion=quaternions),
        )

    def blueprint(self, blueprint: Any) -> None:
        """Set the layout with which the viewer opens the file."""
        self._rec.send_blueprint(blueprint)

    def _write_error(self) -> OSError:
        """Find the cause of a write error, which rerun does not report."""
        full = shutil.disk_usage(self._path.parent).free < _NO_SPACE_BYTES
        code = errno.ENOSPC if full else errno.EIO
        return OSError(code, os.strerror(code), str(self._path))


def part(name: str) -> str:
    """A name as one part of an entity path, which the viewer shows as it is.

    ``dual+`` is ``dual_plus``, ``dual(base)`` is ``dual_base``.
    """
    return rr.escape_entity_path_part(re.sub(r"[(),= ]+", "_", name.replace("+", "_plus")).strip("_"))
