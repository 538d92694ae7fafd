"""A run as a rerun recording. The only file that imports rerun."""

import errno
import os
import shutil
import socket
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.breakages import breakage_outcomes
from experiments.execution import RunRecord, SlamSystem
from experiments.scene import Scene, lay_out
from experiments.summary import is_tracked
from sim.sequence import Sequence
from slam.events import Event
from slam.results import TrackingResult

# rerun reads this when it is loaded. Its writer logs what is raised here as an error of its own.
os.environ.setdefault("RUST_LOG", "off")
import rerun as rr
import rerun.blueprint as rrb

APPLICATION = "dslab"

IMAGES_PER_S = 15.0
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 60]
_IMAGE_WIDTH_PX = 640
_SNAPSHOT_S = 0.5
_MAX_POINTS, _MAX_PATH = 4000, 600
_NO_SPACE_BYTES = 1 << 20

_TRUE, _CAMERA = [150, 150, 150], [255, 255, 255]
_MAPS = ([31, 160, 255], [255, 150, 40], [60, 200, 110], [220, 90, 200], [240, 220, 60], [120, 220, 220])
_FEATURE, _INLIER = 0, 1
_STATES = {
    "tracking": 0x3CB371FF, "not_initialized": 0xE0A030FF, "lost": 0xE04040FF, "relocalizing": 0xD07070FF,
}  # fmt: skip
_SEGMENTS = {"low_texture": 0xC8A040FF, "motion_blur": 0x9060D0FF, "fast_rotation": 0x3090C0FF}
_OTHER_SEGMENT = 0xB06060FF


@dataclass(frozen=True)
class _Snapshot:
    """The map as it stood at one frame, in its own frame."""

    frame: int
    map_id: int
    points: np.ndarray


class Recorder:
    """Writes one run to an .rrd file: frames as they come, everything that needs the truth at the end.

    Images go in at ``IMAGES_PER_S`` at most, JPEG-compressed, and whenever the state changes: under 60 MB per
    minute. Estimates are placed in the world per map by :func:`experiments.scene.lay_out`, for display only.

    Args:
        path: the file to write.
        sequence: what is fed, with its truth.
        system_kind: name of the system, for the title.
    """

    def __init__(self, path: Path, sequence: Sequence, system_kind: str) -> None:
        self._path = path
        self._sequence = sequence
        self._title = f"{sequence.name}, {system_kind}"
        self._stride = max(1, round(sequence.camera.fps / IMAGES_PER_S))
        self._shrink = min(1.0, _IMAGE_WIDTH_PX / sequence.camera.width_px)
        self._snapshots: list[_Snapshot] = []
        self._next_snapshot_s = -np.inf
        self._state = ""

    def __enter__(self) -> Self:
        self._rec = rr.RecordingStream(APPLICATION, recording_id=self._title)
        self._rec.set_log_time_enabled(False)
        self._rec.set_log_tick_enabled(False)
        try:
            self._rec.save(self._path)
        except RuntimeError as error:
            raise self._write_error() from error
        self._rec.send_recording_name(self._title)
        classes = [(_FEATURE, "feature", [110, 130, 160]), (_INLIER, "on the map", [80, 230, 90])]
        self._rec.log("world/camera/features", rr.AnnotationContext(classes), static=True)
        return self

    def __exit__(self, failed: type[BaseException] | None, *rest: object) -> None:
        try:
            self._rec.flush()
        except RuntimeError as error:
            if failed is None:
                raise self._write_error() from error
        finally:
            self._rec.disconnect()

    def _write_error(self) -> OSError:
        """Why the file could not be written; rerun's writer does not say."""
        full = shutil.disk_usage(self._path.parent).free < _NO_SPACE_BYTES
        code = errno.ENOSPC if full else errno.EIO
        return OSError(code, os.strerror(code), str(self._path))

    def frame(self, image: np.ndarray, result: TrackingResult, system: SlamSystem) -> None:
        """Record one frame: image, features and, now and then, the map."""
        changed = result.state != self._state
        self._state = result.state
        if changed or result.frame % self._stride == 0:
            self._set_time(result.frame)
            self._log_image(image, result)
        if is_tracked(result) and result.stamp_s >= self._next_snapshot_s and result.map_id in system.maps():
            self._next_snapshot_s = result.stamp_s + _SNAPSHOT_S
            points = _thin(system.map_points(result.map_id), _MAX_POINTS).astype(np.float32)
            self._snapshots.append(_Snapshot(result.frame, result.map_id, points))

    def finish(self, record: RunRecord) -> None:
        """Write what is known only at the end: the aligned paths, plots, lanes and the blueprint."""
        scene = lay_out(record)
        self._log_truth(scene)
        self._log_camera(record, scene)
        self._log_maps(record, scene)
        self._log_plots(record)
        self._log_lanes(record)
        self._log_events(record.events)
        self._rec.send_blueprint(_blueprint(record, scene))

    def _set_time(self, frame: int) -> None:
        self._rec.set_time("frame", sequence=frame)
        self._rec.set_time("time", duration=float(self._sequence.stamps_s[frame]))

    def _times(self, frames: Iterable[int]) -> list[rr.TimeColumn]:
        frames = np.asarray(list(frames), int)
        return [
            rr.TimeColumn("frame", sequence=frames),
            rr.TimeColumn("time", duration=self._sequence.stamps_s[frames]),
        ]

    def _log_image(self, image: np.ndarray, result: TrackingResult) -> None:
        if self._shrink < 1:
            size = (_IMAGE_WIDTH_PX, round(image.shape[0] * self._shrink))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        encoded = cv2.imencode(".jpg", image, _JPEG)[1].tobytes()
        self._rec.log("world/camera/image", rr.EncodedImage(contents=encoded, media_type="image/jpeg"))
        pixels = (result.keypoints_px + 0.5) * self._shrink
        classes = np.where(result.inlier_mask, _INLIER, _FEATURE).astype(np.uint16)
        radii = rr.Radius.ui_points(1.6)
        self._rec.log("world/camera/features", rr.Points2D(pixels, class_ids=classes, radii=radii))

    def _log_truth(self, scene: Scene) -> None:
        self._rec.log("world", _view_coordinates(scene.up), static=True)
        if scene.T_world_cam is None:
            return
        known = np.isfinite(scene.T_world_cam).all(axis=(1, 2))
        path = scene.T_world_cam[known, :3, 3]
        self._rec.log(
            "world/true_path",
            rr.LineStrips3D([path], colors=_TRUE, radii=rr.Radius.ui_points(1.0)),
            static=True,
        )
        self._rec.log("world/true_camera", self._pinhole(0.03 * scene.extent, _TRUE), static=True)
        self._send_poses("world/true_camera", np.flatnonzero(known), scene.T_world_cam[known])

    def _log_camera(self, record: RunRecord, scene: Scene) -> None:
        self._rec.log("world/camera", self._pinhole(0.06 * scene.extent, _CAMERA), static=True)
        for map_id, alignment in scene.alignments.items():
            live = record.live[map_id]
            self._send_poses("world/camera", live.frames, alignment.poses(live.T_map_cam))

    def _pinhole(self, size: float, color: list[int]) -> rr.Pinhole:
        camera, s = self._sequence.camera, self._shrink
        K = np.array([[camera.fx, 0, camera.cx + 0.5], [0, camera.fy, camera.cy + 0.5], [0, 0, 1]])
        K[:2] *= s
        return rr.Pinhole(
            image_from_camera=K,
            resolution=[camera.width_px * s, camera.height_px * s],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=size,
            color=color,
        )

    def _send_poses(self, path: str, frames: Iterable[int], T_world_cam: np.ndarray) -> None:
        self._rec.send_columns(
            path,
            self._times(frames),
            rr.Transform3D.columns(
                translation=T_world_cam[:, :3, 3],
                quaternion=Rotation.from_matrix(T_world_cam[:, :3, :3]).as_quat(),
            ),
        )

    def _log_maps(self, record: RunRecord, scene: Scene) -> None:
        """The path so far, keyframes and points, each map in its colour, as they stood at the time."""
        keyframes = np.array([r.frame for r in record.results if r.is_keyframe], int)
        for snapshot in self._snapshots:
            if snapshot.map_id not in scene.alignments:
                continue
            self._set_time(snapshot.frame)
            alignment, live = scene.alignments[snapshot.map_id], record.live[snapshot.map_id]
            name, color = f"world/map_{snapshot.map_id}", _MAPS[snapshot.map_id % len(_MAPS)]
            so_far = live.frames <= snapshot.frame
            positions = alignment.points(live.T_map_cam[so_far, :3, 3])
            strips = _strips(live.frames[so_far], positions)
            self._rec.log(
                f"{name}/path", rr.LineStrips3D(strips, colors=color, radii=rr.Radius.ui_points(2.0))
            )
            marked = positions[np.isin(live.frames[so_far], keyframes)]
            self._rec.log(
                f"{name}/keyframes", rr.Points3D(marked, colors=color, radii=rr.Radius.ui_points(3.0))
            )
            points = alignment.points(snapshot.points)
            self._rec.log(
                f"{name}/points", rr.Points3D(points, colors=[*color, 120], radii=rr.Radius.ui_points(1.2))
            )
        self._set_time(len(record.results) - 1)
        for map_id, final in scene.final.items():
            strips = _strips(final.frames, final.T_map_cam[:, :3, 3])
            self._rec.log(
                f"world/final_path/map_{map_id}",
                rr.LineStrips3D(strips, colors=[255, 255, 255], radii=rr.Radius.ui_points(1.2)),
            )

    def _log_plots(self, record: RunRecord) -> None:
        results = record.results
        series = {
            "plots/inliers/inliers": ([float(r.inliers) for r in results], [80, 230, 90]),
            "plots/inliers/matches": ([float(r.matches) for r in results], [110, 130, 160]),
            "plots/cpu_ms/tracking": ([sum(r.cpu_ms.values()) for r in results], [31, 160, 255]),
        }
        times = self._times(range(len(results)))
        for path, (values, color) in series.items():
            name = path.rsplit("/", 1)[1]
            self._rec.log(path, rr.SeriesLines(colors=color, names=name, widths=1.5), static=True)
            self._rec.send_columns(path, times, rr.Scalars.columns(scalars=values))
        mapped = [r for r in results if r.mapping_cpu_ms > 0]
        self._rec.log(
            "plots/cpu_ms/mapping",
            rr.SeriesPoints(colors=[255, 150, 40], names="mapping, per keyframe", marker_sizes=2.0),
            static=True,
        )
        if mapped:
            self._rec.send_columns(
                "plots/cpu_ms/mapping",
                self._times(r.frame for r in mapped),
                rr.Scalars.columns(scalars=[r.mapping_cpu_ms for r in mapped]),
            )

    def _log_lanes(self, record: RunRecord) -> None:
        states = [str(r.state) for r in record.results]
        self._send_lane("lanes/state", states, _STATES)
        maps = [f"map {r.map_id}" if is_tracked(r) else "" for r in record.results]
        palette = {m: _rgba(_MAPS[int(m.split()[1]) % len(_MAPS)]) for m in maps if m}
        self._send_lane("lanes/map", maps, palette)
        kinds = [self._sequence.kinds_at(frame) for frame in range(len(states))]
        # Segments over one another are one state, in the colour of the last that began.
        colors = {" + ".join(k): _SEGMENTS.get(k[-1], _OTHER_SEGMENT) for k in kinds if k}
        self._send_lane("lanes/segment", [" + ".join(k) for k in kinds], colors)

    def _send_lane(self, path: str, values: list[str], colors: dict[str, int]) -> None:
        labels = [v.replace("_", " ") for v in colors]
        rgba = np.array(list(colors.values()), np.uint32)
        config = rr.StateConfiguration(values=list(colors), labels=labels, colors=rgba)
        self._rec.log(path, config, static=True)
        changes = [f for f, value in enumerate(values) if f == 0 or value != values[f - 1]]
        states = rr.StateChange.columns(state=[values[f] for f in changes])
        self._rec.send_columns(path, self._times(changes), states)

    def _log_events(self, events: Iterable[Event]) -> None:
        for event in events:
            self._set_time(event.frame)
            text, level = describe_event(event)
            self._rec.log("events", rr.TextLog(text, level=level))


def describe_event(event: Event) -> tuple[str, str]:
    """(text, level) of an event for the log."""
    fields = event.record()
    kind, frame, stamp_s = fields.pop("event"), fields.pop("frame"), fields.pop("stamp_s")
    level = {"breakage": "ERROR", "map_dropped": "WARN"}.get(kind, "INFO")
    if fields.get("success") is False or fields.get("accepted") is False:
        level = "WARN"
    details = ", ".join(
        f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in fields.items() if v != ""
    )
    return f"{stamp_s:.2f} s  frame {frame}  {kind.replace('_', ' ')}: {details}", level


def open_viewer(path: Path, stamp_s: float) -> None:
    """Open a recording in the viewer, paused at a time; the viewer outlives this process.

    Raises:
        ConnectionError: the viewer does not start, for want of a display as a rule.
    """
    from rerun.experimental import ViewerClient

    try:
        viewer = ViewerClient.spawn(
            port=_free_port(),
            executable_path=str(Path(sys.executable).with_name("rerun")),
            detach_process=True,
        )
        viewer.open(str(path.resolve()))
        viewer.set_time("time", duration=stamp_s, play_state="paused")
    except RuntimeError as error:
        raise ConnectionError(str(error)) from error


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _blueprint(record: RunRecord, scene: Scene) -> rrb.Blueprint:
    """The 3D view framed on the path, the time from the first breakage on selected.

    A blueprint cannot set the time cursor; :func:`open_viewer` puts it on the breakage.
    """
    sequence = record.sequence
    across = np.roll(np.abs(scene.up), 1) * 0.8 + np.roll(np.abs(scene.up), 2) * 0.6
    eye = scene.centre + scene.extent * (1.7 * scene.up - 0.8 * across)
    world = rrb.Spatial3DView(
        name="map (estimate aligned to truth for display)" if scene.T_world_cam is not None else "map",
        origin="world",
        contents=["+ world/**", "- world/camera/features/**"],
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=scene.centre, eye_up=scene.up
        ),
    )
    image = rrb.Spatial2DView(
        name="camera (green: on the map)", origin="world/camera", contents=["+ $origin/**"]
    )
    inliers = rrb.TimeSeriesView(name="inliers and matches", origin="plots/inliers")
    cpu = rrb.TimeSeriesView(
        name="CPU ms per frame", origin="plots/cpu_ms", axis_y=rrb.ScalarAxis(range=(0.0, _usual_ms(record)))
    )
    lanes = rrb.StateTimelineView(name="state, map, injected segment", origin="lanes")
    log = rrb.TextLogView(
        name="events",
        origin="events",
        columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=["LogLevel", "Body"]),
    )
    outcomes = breakage_outcomes(record.events, sequence.segments, list(sequence.stamps_s))
    start_s = outcomes[0].breakage.stamp_s if outcomes else float(sequence.stamps_s[0])
    end_s = float(sequence.stamps_s[-1])
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(image, lanes, inliers, cpu, row_shares=[9, 5, 4, 4]),
            rrb.Vertical(world, log, row_shares=[14, 8]),
            column_shares=[1, 1],
        ),
        rrb.TimePanel(
            state="collapsed",
            timeline="time",
            play_state="following",
            time_selection=rr.encodings.AbsoluteTimeRange(
                min=rr.encodings.TimeInt(seconds=start_s), max=rr.encodings.TimeInt(seconds=end_s)
            ),
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _usual_ms(record: RunRecord) -> float:
    """Top of the time plot: the first frame, which loads the kernels, would flatten all others."""
    times = [max(sum(r.cpu_ms.values()), r.mapping_cpu_ms) for r in record.results]
    return max(1.0, 1.3 * float(np.percentile(times, 98)))


def _view_coordinates(up: np.ndarray) -> rr.ViewCoordinates:
    axis = "XYZ"[int(np.abs(up).argmax())]
    sign = "UP" if up.sum() > 0 else "DOWN"
    return getattr(rr.ViewCoordinates, f"RIGHT_HAND_{axis}_{sign}")


def _strips(frames: np.ndarray, positions: np.ndarray) -> list[np.ndarray]:
    """The path cut where frames are missing, thinned to what the eye can follow."""
    if not len(frames):
        return []
    pieces = np.split(positions, np.flatnonzero(np.diff(frames) > 1) + 1)
    budget = max(2, _MAX_PATH // len(pieces))
    return [np.concatenate([_thin(piece, budget), piece[-1:]]) for piece in pieces]


def _thin(rows: np.ndarray, most: int) -> np.ndarray:
    return rows[:: max(1, -(-len(rows) // most))]


def _rgba(rgb: list[int]) -> int:
    return rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | 255
