"""Recorder of runs of one or more systems over a sequence, into one file."""

from collections.abc import Sequence as Many
from pathlib import Path
from typing import Self

import cv2
import numpy as np
import rerun as rr

from dslab.experiments.evaluation.scene import lay_out
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.recording import palette
from dslab.experiments.recording.blueprint import make_blueprint, world_aspect
from dslab.experiments.recording.drawing import (
    MapSnapshot,
    RunDrawing,
    draw_lane,
    draw_truth,
)
from dslab.experiments.recording.key import draw_key
from dslab.experiments.recording.lanes import INJECTED, SYSTEMS, segment_lanes, system_lanes
from dslab.experiments.recording.paths import thin
from dslab.experiments.recording.stream import Stream, part
from dslab.experiments.recording.viewpoint import viewpoint
from dslab.experiments.runs.execution import RunRecord, SlamSystem
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import PhotometricView, TrackingResult

IMAGES_PER_S = 10.0
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 60]
_IMAGE_WIDTH_PX = 640
_SNAPSHOT_S = 0.5
_MAX_POINTS = 3000
_MAX_RESIDUALS = 1500


class Recording:
    """Writer of runs over one sequence to one .rrd file.

    Frames are written as they come; what needs the truth or the whole run is written at the end. The systems
    run one after the other, each observed by the result of :meth:`watch`; then call :meth:`finish`. Maps are
    placed by :class:`experiments.recording.placement.Placements`, for display only.

    Images are written once for all systems, at most ``IMAGES_PER_S`` per second, as JPEG: a minute of
    640 x 480 at 30 fps with two systems stays under 60 MB.

    Args:
        path: file to write.
        sequence: the input sequence, with its ground truth.
        systems: names of the systems, in display order.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, sequence: Sequence, systems: Many[str]) -> None:
        self._path = path
        self._sequence = sequence
        self._systems = tuple(systems)
        self._shrink = min(1.0, _IMAGE_WIDTH_PX / sequence.camera.width_px)
        self._shown: set[int] = set()
        self._watchers: dict[str, SystemRecorder] = {}

    def __enter__(self) -> Self:
        title = f"{self._sequence.name}: {' and '.join(self._systems)}"
        self._stream = Stream(self._path, title, self._sequence.stamps_s)
        return self

    def __exit__(self, failed: type[BaseException] | None, *rest: object) -> None:
        self._stream.close(failed is not None)

    def watch(self, system: str) -> "SystemRecorder":
        """Create the observer of one system's run."""
        self._watchers[system] = SystemRecorder(self, system)
        return self._watchers[system]

    def finish(self, records: Many[RunRecord]) -> None:
        """Write aligned paths, plots, lanes and the blueprint.

        Args:
            records: the runs, one per observed system.
        """
        for frame, stamp_s in enumerate(records[0].sequence.stamps_s):
            self.place(frame, float(stamp_s))
        view = viewpoint([lay_out(record) for record in records])
        draw_truth(self._stream, records[0].sequence, view, self._shrink)
        in_view = []
        for place, record in enumerate(records):
            watcher = self._watchers[record.system_kind]
            drawing = RunDrawing(self._stream, record, view, self._shrink)
            drawing.draw(watcher.snapshots, watcher.residuals, palette.system_color(place))
            in_view.append(drawing.in_view())
        residuals = {system: watcher.residuals for system, watcher in self._watchers.items()}
        key = draw_key(self._stream, palette.KEY | (palette.DIRECT_KEY if any(residuals.values()) else {}))
        lanes = self._draw_lanes(records)
        eye = view.eye(np.concatenate(in_view), world_aspect(len(records)))
        self._stream.blueprint(make_blueprint(records, view, eye, self._shrink, lanes, residuals, key))

    def _draw_lanes(self, records: Many[RunRecord]) -> int:
        """Draw the lanes of segments and systems; returns their number."""
        lanes = [(INJECTED, lane) for lane in segment_lanes(records[0])]
        for record in records:
            lanes += [(f"{SYSTEMS}/{part(record.system_kind)}", lane) for lane in system_lanes(record)]
        for under, lane in lanes:
            draw_lane(self._stream, under, lane)
        return len(lanes)

    def place(self, frame: int, stamp_s: float) -> None:
        """Give a frame that was fed its time."""
        self._stream.place(frame, stamp_s)

    def show_image(self, frame: int, image: np.ndarray) -> None:
        """Write the image of a frame, once for all systems."""
        if frame in self._shown:
            return
        self._shown.add(frame)
        if self._shrink < 1:
            size = (_IMAGE_WIDTH_PX, round(image.shape[0] * self._shrink))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        encoded = cv2.imencode(".jpg", image, _JPEG)[1].tobytes()
        self._stream.log("camera/image", frame, rr.EncodedImage(contents=encoded, media_type="image/jpeg"))

    def show_features(self, system: str, result: TrackingResult) -> None:
        """Write the features of a frame, inliers of the map separately."""
        pixels = ((result.keypoints_px + 0.5) * self._shrink).astype(np.float32)
        inlier = result.inlier_mask & is_tracked(result)
        for name, chosen, color, radius in (
            ("features", ~inlier, palette.FEATURE, 1.2),
            ("inliers", inlier, palette.INLIER, 1.8),
        ):
            dots = rr.Points2D(pixels[chosen], colors=[color], radii=rr.Radius.ui_points(radius))
            self._stream.log(f"camera/{part(system)}/{name}", result.frame, dots)

    def show_residuals(self, system: str, frame: int, view: PhotometricView) -> None:
        """Write the pixels that a direct system compares in a frame, coloured by their residuals."""
        rows = thin(np.arange(len(view.residual)), _MAX_RESIDUALS)
        pixels = ((view.pixels_px[rows] + 0.5) * self._shrink).astype(np.float32)
        colors = palette.residual_colors(view.residual[rows])
        dots = rr.Points2D(pixels, colors=colors, radii=rr.Radius.ui_points(1.8))
        self._stream.log(f"camera/{part(system)}/residuals", frame, dots)

    @property
    def stride(self) -> int:
        """Number of frames from one image to the next."""
        return max(1, round(self._sequence.camera.fps / IMAGES_PER_S))


class SystemRecorder:
    """Observer of one system's run, made by :meth:`Recording.watch`.

    Attributes:
        snapshots: the thinned map at intervals.
        residuals: root mean square by frame that is no keyframe, of a direct system; NaN without a pose.
    """

    def __init__(self, recording: Recording, system: str) -> None:
        self.snapshots: list[MapSnapshot] = []
        self.residuals: dict[int, float] = {}
        self._recording = recording
        self._system = system
        self._next_snapshot_s, self._map_id = -np.inf, -1
        self._state = ""
        self._window: tuple[int, ...] = ()

    def frame(self, image: np.ndarray, result: TrackingResult, system: SlamSystem) -> None:
        """Record one frame: image, features and, at intervals, the map."""
        self._recording.place(result.frame, result.stamp_s)
        changed = result.state != self._state
        self._state = result.state
        if changed or result.frame % self._recording.stride == 0:
            self._recording.show_image(result.frame, image)
            if hasattr(system, "photometric_view"):  # one that compares intensities
                self._show_residuals(result.frame, system.photometric_view(image) or PhotometricView.none())
            else:
                self._recording.show_features(self._system, result)
        is_due = result.stamp_s >= self._next_snapshot_s or result.map_id != self._map_id
        if is_tracked(result) and is_due and result.map_id in system.maps():
            self._map_id, self._next_snapshot_s = result.map_id, result.stamp_s + _SNAPSHOT_S
            points = thin(system.map_points(result.map_id), _MAX_POINTS).astype(np.float32)
            self.snapshots.append(MapSnapshot(result.frame, result.map_id, points, self._window))

    def _show_residuals(self, frame: int, view: PhotometricView) -> None:
        self._window = view.keyframes
        if frame not in view.keyframes:  # a keyframe is compared with itself
            squares = view.residual.astype(float) ** 2
            self.residuals[frame] = float(np.sqrt(squares.mean())) if len(squares) else np.nan
        self._recording.show_residuals(self._system, frame, view)
