"""Drawing of a finished run: paths, maps, marks, plots, lanes, log."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rerun as rr

from dslab.experiments.evaluation.audit_report import audit_record
from dslab.experiments.evaluation.audit_text import audit_text
from dslab.experiments.evaluation.scene import Scene
from dslab.experiments.recording import palette
from dslab.experiments.recording.describe import describe_event
from dslab.experiments.recording.lanes import Lane
from dslab.experiments.recording.palette import Color
from dslab.experiments.recording.paths import RunPaths, pins, thin
from dslab.experiments.recording.stories import stories
from dslab.experiments.recording.stream import Stream, part
from dslab.experiments.runs.execution import RunRecord
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage

INJECTED, SYSTEMS = "injected", "slam"
"""Paths of the lanes of segments and of systems, in this order in the viewer."""

_STEP_S = 0.5
_MOST_DOTS = 60


def draw_truth(stream: Stream, sequence: Sequence, scene: Scene, shrink: float) -> None:
    """Draw the axes of the world, and the true path and camera where known.

    Args:
        stream: the file.
        sequence: the input sequence.
        scene: common scene of all runs.
        shrink: scale of the recorded images relative to the input images.
    """
    stream.static("world", _view_coordinates(scene.up))
    if scene.T_world_cam is None:
        return
    known = np.isfinite(scene.T_world_cam).all(axis=(1, 2))
    # Dots, between which the estimate can be seen.
    places = thin(scene.T_world_cam[known, :3, 3], _MOST_DOTS)
    path = rr.Points3D(places, colors=palette.TRUTH, radii=rr.Radius.ui_points(2.6))
    stream.static("world/true_path", path)
    stream.static("world/true_camera", pinhole(sequence, shrink, 0.03 * scene.extent, palette.TRUTH))
    stream.poses("world/true_camera", np.flatnonzero(known), scene.T_world_cam[known])


def pinhole(sequence: Sequence, shrink: float, size: float, color: Color) -> rr.Pinhole:
    """Pinhole camera of the sequence for rerun."""
    camera = sequence.camera
    # Pixel (0, 0) is a corner in rerun, here the centre of the first pixel.
    K = np.array([[camera.fx, 0, camera.cx + 0.5], [0, camera.fy, camera.cy + 0.5], [0, 0, 1]])
    K[:2] *= shrink
    return rr.Pinhole(
        image_from_camera=K,
        resolution=[camera.width_px * shrink, camera.height_px * shrink],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=size,
        color=list(color),
    )


@dataclass(frozen=True)
class MapSnapshot:
    """Points of a map at one frame, in map coordinates.

    Attributes:
        frame, map_id: frame of the snapshot and id of the map.
        points: (n, 3) float32 map units.
        window: frames of the keyframes that are adjusted together, of a direct system.
    """

    frame: int
    map_id: int
    points: np.ndarray
    window: tuple[int, ...] = ()


class RunDrawing:
    """Draw one run under the name of its system.

    Args:
        stream: the file.
        record: the run.
        scene: alignment of its maps with the world.
        extent: extent of all drawn paths, for the sizes of symbols.
        shrink: scale of the recorded images relative to the input images.
    """

    def __init__(self, stream: Stream, record: RunRecord, scene: Scene, extent: float, shrink: float) -> None:
        self._stream = stream
        self._record = record
        self._scene = scene
        self._extent = extent
        self._shrink = shrink
        self._paths = RunPaths(record, scene)
        self._name = part(record.system_kind)
        self._world = f"world/{self._name}"

    def draw(self, snapshots: list[MapSnapshot], residuals: dict[int, float], color: Color) -> None:
        """Draw everything; ``residuals`` by frame, ``color`` that of the system's curves."""
        self._draw_camera()
        self._draw_paths()
        self._draw_maps(snapshots)
        self._draw_marks()
        self._draw_curves(residuals, color)
        self._draw_log()

    def _draw_camera(self) -> None:
        """Draw the estimated camera in the colour of its state; without a pose it stays."""
        entity, state = f"{self._world}/camera", None
        for result in self._record.results:
            if result.state != state:
                state = result.state
                color = palette.STATES.get(str(state), palette.NOTE)
                size = 0.06 * self._extent
                self._stream.log(
                    entity, result.frame, pinhole(self._record.sequence, self._shrink, size, color)
                )
        for map_id, alignment in self._scene.alignments.items():
            live = self._record.live[map_id]
            self._stream.poses(entity, live.frames, alignment.poses(live.T_map_cam))

    def _draw_paths(self) -> None:
        """Draw the paths over time: live per map, recovered, and lost."""
        last = len(self._record.results) - 1
        step = max(1, round(_STEP_S * self._record.sequence.camera.fps))
        changes = {e.frame for e in self._record.events}
        for frame in sorted({*range(0, last + 1, step), *changes, last}):
            for map_id in self._scene.alignments:
                if self._record.live[map_id].frames[0] <= frame:
                    strips = self._paths.live_strips(map_id, frame)
                    self._line(f"map_{map_id}/path", frame, strips, palette.map_color(map_id), 1.5)
            self._line("recovered", frame, self._paths.recovered_strips(frame), palette.RECOVERED, 4.0)
            self._line("lost", frame, self._paths.lost_strips(frame), palette.LOST, 2.5)

    def _line(self, name: str, frame: int, strips: list[np.ndarray], color: Color, width: float) -> None:
        line = rr.LineStrips3D(strips, colors=color, radii=rr.Radius.ui_points(width))
        self._stream.log(f"{self._world}/{name}", frame, line)

    def _draw_maps(self, snapshots: list[MapSnapshot]) -> None:
        """Draw points and keyframes over time, each map in its colour."""
        keyframes = np.array([r.frame for r in self._record.results if r.is_keyframe], int)
        for snapshot in snapshots:
            map_id, frame = snapshot.map_id, snapshot.frame
            if map_id not in self._scene.alignments:
                continue
            color, entity = palette.map_color(map_id), f"{self._world}/map_{map_id}"
            live = self._record.live[map_id]
            chosen = np.isin(live.frames[live.frames <= frame], keyframes)
            centres = self._paths.live(map_id, frame)[chosen, :3, 3]
            dots = rr.Points3D(centres, colors=color, radii=rr.Radius.ui_points(1.5))
            self._stream.log(f"{entity}/keyframes", frame, dots)
            points = self._scene.alignments[map_id].points(snapshot.points).astype(np.float32)
            cloud = rr.Points3D(points, colors=[*color, 120], radii=rr.Radius.ui_points(1.2))
            self._stream.log(f"{entity}/points", frame, cloud)
            if snapshot.window:
                chosen = np.isin(live.frames[live.frames <= frame], snapshot.window)
                self._draw_window(frame, self._paths.live(map_id, frame)[chosen, :3, 3])
        if any(snapshot.window for snapshot in snapshots):
            for event in self._record.events:
                if isinstance(event, Breakage):
                    self._draw_window(event.frame, np.empty((0, 3)))

    def _draw_window(self, frame: int, centres: np.ndarray) -> None:
        """Draw the (n, 3) keyframes that a direct system adjusts together."""
        dots = rr.Points3D(centres, colors=palette.WINDOW, radii=rr.Radius.ui_points(4.0))
        self._stream.log(f"{self._world}/window", frame, dots)

    def _draw_marks(self) -> None:
        """Draw breakages as labelled pins and repairs as dots."""
        found = [(story, self._paths.position(story.frame)) for story in stories(self._record)]
        told = [(story, at) for story, at in found if at is not None]
        needles = pins([at for _, at in told], self._scene.up, self._extent)
        ends = {
            story.end: at
            for story, _ in told
            if story.end and story.is_repaired and (at := self._paths.position(story.end)) is not None
        }
        for frame in sorted({story.frame for story, _ in told} | set(ends)):
            known = [
                (story, needle)
                for (story, _), needle in zip(told, needles, strict=True)
                if story.frame <= frame
            ]
            self._dots("breakages", frame, [needle[0] for _, needle in known], palette.LOST, 6.0)
            self._dots("repairs", frame, [at for end, at in ends.items() if end <= frame], palette.FUSED, 6.0)
            self._line("marks/pins", frame, [needle for _, needle in known], palette.LOST, 1.0)
            heads, labels = [needle[1] for _, needle in known], [story.text_at(frame) for story, _ in known]
            self._dots("labels", frame, heads, palette.LOST, 1.0, labels)

    def _dots(
        self,
        name: str,
        frame: int,
        positions: list[np.ndarray],
        color: Color,
        radius: float,
        labels: list[str] | None = None,
    ) -> None:
        dots = rr.Points3D(
            positions,
            colors=color,
            radii=rr.Radius.ui_points(radius),
            labels=labels,
            show_labels=bool(labels),
        )
        self._stream.log(f"{self._world}/marks/{name}", frame, dots)

    def _draw_log(self) -> None:
        stamps_s = self._record.sequence.stamps_s
        for event in self._record.events:
            time_s = stamps_s[event.frame] - stamps_s[0]
            text, color = describe_event(event)
            line = rr.TextLog(f"{self._record.system_kind}  {time_s:.2f} s  {text}", color=color)
            self._stream.log(f"events/{self._name}", event.frame, line)
        found = audit_text({"audit": audit_record(self._record)})
        line = rr.TextLog(f"{self._record.system_kind}  {found}", color=palette.PLAIN)
        self._stream.log(f"events/{self._name}", len(stamps_s) - 1, line)

    def _draw_curves(self, residuals: dict[int, float], color: Color) -> None:
        results = self._record.results
        frames = range(len(results))
        self._curve("inliers", frames, [float(r.inliers) for r in results], color)
        self._curve("ms", frames, [sum(r.ms.values()) for r in results], color)
        if residuals:
            self._curve("residual", residuals, list(residuals.values()), color)

    def _curve(self, plot: str, frames: Iterable[int], values: list[float], color: Color) -> None:
        entity = f"plots/{plot}/{self._name}"
        line = rr.SeriesLines(colors=list(color), names=self._record.system_kind, widths=1.5)
        self._stream.static(entity, line)
        self._stream.columns(entity, frames, rr.Scalars.columns(scalars=values))


def draw_lane(stream: Stream, under: str, lane: Lane, frames: int) -> None:
    """Draw a lane of a run of some frames as a row of the timeline view.

    A value whose words do not fit into its time is drawn without them.
    """
    entity = f"{under}/{part(lane.name)}"
    spans = lane.labelled(frames)
    styles = {
        shown(value, fits): (value if fits else " ", lane.colors[value]) for _, value, fits in spans if value
    }
    labels, colors = zip(*styles.values(), strict=True)
    rgba = np.array([palette.rgba(color) for color in colors], np.uint32)
    stream.static(entity, rr.StateConfiguration(values=list(styles), labels=labels, colors=rgba))
    changes = rr.StateChange.columns(state=[shown(value, fits) for _, value, fits in spans])
    stream.columns(entity, [frame for frame, _, _ in spans], changes)


def shown(value: str, fits: bool) -> str:
    """The state that is drawn for a value: with another one, words may be left out."""
    return value if fits else f"{value} (brief)"


def _view_coordinates(up: np.ndarray) -> rr.ViewCoordinates:
    axis = "XYZ"[int(np.abs(up).argmax())]
    sign = "UP" if up.sum() > 0 else "DOWN"
    return getattr(rr.ViewCoordinates, f"RIGHT_HAND_{axis}_{sign}")
