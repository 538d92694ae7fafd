"""Drawing of a finished run: paths, maps, marks, plots, lanes, log."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rerun as rr

from dslab.experiments.evaluation.alignment import Similarity
from dslab.experiments.evaluation.audit_report import audit_record
from dslab.experiments.evaluation.audit_text import audit_text
from dslab.experiments.recording import palette
from dslab.experiments.recording.describe import describe_event
from dslab.experiments.recording.lanes import Lane
from dslab.experiments.recording.palette import Color
from dslab.experiments.recording.paths import LABEL_WIDTH, RunPaths, pins, thin
from dslab.experiments.recording.placement import Placements
from dslab.experiments.recording.stories import stories
from dslab.experiments.recording.stream import Stream, part
from dslab.experiments.recording.viewpoint import Viewpoint
from dslab.experiments.runs.execution import RunRecord
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage

_STEP_S = 0.5
_MOST_DOTS = 60
_ASIDE, _LABEL_ASIDE = 0.2, 0.1
"""Distance of a map in its own frame from where it begins, of a label from its map, shares of the extent."""


def draw_truth(stream: Stream, sequence: Sequence, view: Viewpoint, shrink: float) -> None:
    """Draw the axes of the world, and the true path and camera where known.

    Args:
        stream: the file.
        sequence: the input sequence.
        view: how the scene is looked at.
        shrink: scale of the recorded images relative to the input images.
    """
    stream.static("world", _view_coordinates(view.up))
    truth = sequence.T_world_cam
    if truth is None:
        return
    known = np.isfinite(truth).all(axis=(1, 2))
    # Dots, between which the estimate can be seen.
    places = thin(truth[known, :3, 3], _MOST_DOTS)
    path = rr.Points3D(places, colors=palette.TRUTH, radii=rr.Radius.ui_points(2.6))
    stream.static("world/true_path", path)
    stream.static("world/true_camera", pinhole(sequence, shrink, 0.03 * view.extent, palette.TRUTH))
    stream.poses("world/true_camera", np.flatnonzero(known), truth[known])


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

    Each map has an entity, under which its path, keyframes and points lie in its own coordinates. The
    transform of the entity places it.

    Args:
        stream: the file.
        record: the run.
        view: how the scene is looked at, and how large its symbols are.
        shrink: scale of the recorded images relative to the input images.
    """

    def __init__(self, stream: Stream, record: RunRecord, view: Viewpoint, shrink: float) -> None:
        self._stream = stream
        self._record = record
        self._view = view
        self._shrink = shrink
        self._maps = Placements(record, -_ASIDE * view.extent * view.across)
        self._paths = RunPaths(record, self._maps)
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
                size = 0.06 * self._view.extent
                self._stream.log(
                    entity, result.frame, pinhole(self._record.sequence, self._shrink, size, color)
                )
        for map_id, places in self._maps.places.items():
            live = self._record.live[map_id]
            ends = [*(place.frame for place in places[1:]), len(self._record.results)]
            for place, end in zip(places, ends, strict=False):  # of some it is not known where they lie
                path = live.where((live.frames >= place.frame) & (live.frames < end))
                self._stream.poses(entity, path.frames, place.S_world_map.poses(path.T_map_cam))

    def _draw_paths(self) -> None:
        """Draw the paths over time: live per map, recovered, and lost."""
        last = len(self._record.results) - 1
        step = max(1, round(_STEP_S * self._record.sequence.camera.fps))
        changes = {e.frame for e in self._record.events}
        changes |= {f for recovery in self._paths.recoveries for f in range(recovery.start, recovery.end)}
        for frame in sorted({*range(0, last + 1, step), *changes, last}):
            for map_id in self._maps.places:
                if self._maps.is_there(map_id, frame):
                    strips = self._paths.live_strips(map_id, frame)
                    self._line(f"map_{map_id}/path", frame, strips, palette.map_color(map_id), 1.5)
            self._line("recovered", frame, self._paths.recovered_strips(frame), palette.RECOVERED, 4.0)
            self._line("lost", frame, self._paths.lost_strips(frame), palette.LOST, 2.5)

    def _line(self, name: str, frame: int, strips: list[np.ndarray], color: Color, width: float) -> None:
        line = rr.LineStrips3D(strips, colors=color, radii=rr.Radius.ui_points(width))
        self._stream.log(f"{self._world}/{name}", frame, line)

    def _draw_maps(self, snapshots: list[MapSnapshot]) -> None:
        """Draw points and keyframes over time, each map in its colour; those that are no more go."""
        keyframes = np.array([r.frame for r in self._record.results if r.is_keyframe], int)
        for map_id, places in self._maps.places.items():
            entity = f"{self._world}/map_{map_id}"
            for place in places:
                self._stream.log(entity, place.frame, transform(place.S_world_map))
            if map_id in self._maps.absorbed:
                self._stream.log(f"{entity}/points", self._maps.absorbed[map_id], rr.Clear(recursive=False))
            if map_id in self._maps.dropped:
                self._stream.log(entity, self._maps.dropped[map_id], rr.Clear(recursive=True))
        for snapshot in snapshots:
            map_id, frame = snapshot.map_id, snapshot.frame
            if not self._maps.is_there(map_id, frame):
                continue
            color, entity = palette.map_color(map_id), f"{self._world}/map_{map_id}"
            live = self._record.live[map_id]
            chosen = np.isin(live.frames, keyframes) & (live.frames <= frame)
            centres = live.T_map_cam[chosen, :3, 3]
            dots = rr.Points3D(centres, colors=color, radii=rr.Radius.ui_points(1.5))
            self._stream.log(f"{entity}/keyframes", frame, dots)
            cloud = rr.Points3D(snapshot.points, colors=[*color, 120], radii=rr.Radius.ui_points(1.2))
            self._stream.log(f"{entity}/points", frame, cloud)
            if snapshot.window:
                chosen = np.isin(live.frames, snapshot.window) & (live.frames <= frame)
                place = self._maps.at(map_id, frame)
                assert place is not None  # it is there
                self._draw_window(frame, place.S_world_map.points(live.T_map_cam[chosen, :3, 3]))
        if any(snapshot.window for snapshot in snapshots):
            for event in self._record.events:
                if isinstance(event, Breakage):
                    self._draw_window(event.frame, np.empty((0, 3)))

    def _draw_window(self, frame: int, centres: np.ndarray) -> None:
        """Draw the (n, 3) keyframes that a direct system adjusts together."""
        dots = rr.Points3D(centres, colors=palette.WINDOW, radii=rr.Radius.ui_points(4.0))
        self._stream.log(f"{self._world}/window", frame, dots)

    def _draw_marks(self) -> None:
        """Draw breakages and repairs as dots, and what they and the maps are as labels beside the path."""
        found = [(story, self._paths.position(story.frame)) for story in stories(self._record)]
        told = [(story, at) for story, at in found if at is not None]
        needles = self._needles([at for _, at in told])
        ends = {
            story.end: at
            for story, _ in told
            if story.end and story.is_repaired and (at := self._paths.position(story.end)) is not None
        }
        for frame in sorted({story.frame for story, _ in told} | set(ends) | self._maps.changes()):
            known = [
                (story, needle)
                for (story, _), needle in zip(told, needles, strict=True)
                if story.frame <= frame
            ]
            self._dots("breakages", frame, [needle[0] for _, needle in known], palette.LOST, 6.0)
            self._dots("repairs", frame, [at for end, at in ends.items() if end <= frame], palette.FUSED, 6.0)
            self._line("marks/pins", frame, [needle for _, needle in known], palette.LOST, 1.0)
            heads, labels = [needle[1] for _, needle in known], [story.label_at(frame) for story, _ in known]
            self._dots("labels", frame, heads, palette.LOST, 1.0, labels)
            self._label_maps(frame)

    def _needles(self, feet: list[np.ndarray]) -> list[np.ndarray]:
        return pins(feet, self._view.across, self._view.far, self._view.extent)

    def _label_maps(self, frame: int) -> None:
        """Name the maps that are in their own frames beside where they begin."""
        told = [map_id for map_id in self._maps.places if self._maps.stands_alone(map_id, frame)]
        told = [map_id for map_id in told if self._is_own(map_id, frame)]
        dots = rr.Points3D(
            [self._beside(map_id, frame) for map_id in told],
            colors=[palette.map_color(map_id) for map_id in told],
            labels=[f"map {map_id}: own scale" for map_id in told],
            show_labels=True,
            radii=rr.Radius.ui_points(1.0),
        )
        self._stream.log(f"{self._world}/marks/maps", frame, dots)

    def _is_own(self, map_id: int, frame: int) -> bool:
        place = self._maps.at(map_id, frame)
        return place is not None and place.is_own

    def _beside(self, map_id: int, frame: int) -> np.ndarray:
        """Position of the label of a map at a frame."""
        place = self._maps.at(map_id, frame)
        assert place is not None  # it is there
        first = place.S_world_map.points(self._record.live[map_id].T_map_cam[:1, :3, 3])[0]
        return first - _LABEL_ASIDE * self._view.extent * self._view.across

    def in_view(self) -> np.ndarray:
        """(n, 3) positions in the world that are to be in view: paths wherever they are drawn, and labels.

        A map in its own frame may be of any size: of it what is not further away than half the extent.
        """
        feet = [self._paths.position(story.frame) for story in stories(self._record)]
        labels = [needle[1] for needle in self._needles([foot for foot in feet if foot is not None])]
        truth, extent = self._record.sequence.T_world_cam, self._view.extent
        paths = [np.empty((0, 3))] if truth is None else [truth[np.isfinite(truth).all(axis=(1, 2)), :3, 3]]
        for map_id, places in self._maps.places.items():
            for place in places:
                path = place.S_world_map.points(self._record.live[map_id].T_map_cam[:, :3, 3])
                near = np.linalg.norm(path - path[0], axis=1) < extent / 2
                paths.append(path[near] if place.is_own else path)
                labels += [self._beside(map_id, place.frame)] if place.is_own else []
        half = LABEL_WIDTH / 2 * extent * self._view.along
        return np.concatenate([*paths, *([label - half, label + half] for label in labels)])

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


def draw_lane(stream: Stream, under: str, lane: Lane) -> None:
    """Draw a lane as a row of the timeline view, which cuts off words that are longer than their time."""
    entity = f"{under}/{part(lane.name)}"
    values, colors = list(lane.colors), [palette.rgba(color) for color in lane.colors.values()]
    stream.static(
        entity, rr.StateConfiguration(values=values, labels=values, colors=np.array(colors, np.uint32))
    )
    changes = rr.StateChange.columns(state=[value for _, value in lane.changes])
    stream.columns(entity, [frame for frame, _ in lane.changes], changes)


def transform(S_world_map: Similarity) -> rr.Transform3D:
    """Place of a map in the world for rerun."""
    return rr.Transform3D(
        translation=S_world_map.t_world_map, mat3x3=S_world_map.scale * S_world_map.R_world_map
    )


def _view_coordinates(up: np.ndarray) -> rr.ViewCoordinates:
    axis = "XYZ"[int(np.abs(up).argmax())]
    sign = "UP" if up.sum() > 0 else "DOWN"
    return getattr(rr.ViewCoordinates, f"RIGHT_HAND_{axis}_{sign}")
