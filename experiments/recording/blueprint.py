"""Layout of a recording: systems side by side, lanes and curves over a shared time."""

from collections.abc import Sequence as Many

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dslab.experiments.recording.lanes import INJECTED, SYSTEMS
from dslab.experiments.recording.stream import part
from dslab.experiments.recording.viewpoint import Viewpoint
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Breakage, MapCut

_HEIGHT_PX, _LANES_PX, _LANE_PX, _MOST_LANES_PX = 800, 56, 40, 560
"""Heights on a screen of usual size: of all, of the head of the timeline, of a lane, of the timeline."""
_COLUMNS = 5.0, 9.0
_WIDTH_PX, _WORLD_PX = 1400 * _COLUMNS[1] / sum(_COLUMNS), 340
"""Width of the views of the world together, and their height, on such a screen."""
_ABOUT_S = 3.0
"""Time before and after the first breakage with which a recording opens."""
_SPEED = 0.25
"""Of the playback: a recovery takes tenths of a second."""
_GRID = (255, 255, 255, 10)


def make_blueprint(
    records: Many[RunRecord],
    view: Viewpoint,
    eye: tuple[np.ndarray, np.ndarray],
    shrink: float,
    lanes: int,
    residuals: dict[str, dict[int, float]],
    key: rrb.Spatial2DView,
) -> rrb.Blueprint:
    """Make the layout for runs over one sequence.

    Lanes and curves open about the first breakage. A blueprint cannot set the time cursor, which opens at the
    end: :func:`experiments.recording.viewer.open_viewer` sets it on the breakage.

    Args:
        records: one run per system.
        view: how the scene is looked at.
        eye: position of the eye and what it looks at.
        shrink: scale of the recorded images relative to the input images.
        lanes: number of lanes of the timeline.
        residuals: root mean square by frame, of every system; empty unless it is a direct one.
        key: view of the key of the colours.
    """
    camera = records[0].sequence.camera
    size = camera.width_px * shrink, camera.height_px * shrink
    kinds = [record.system_kind for record in records]
    results = [result for record in records for result in record.results]
    start_s, end_s = opening_s(records)
    axis = rrb.TimeAxis(
        view_range=rr.TimeRange(
            start=rr.TimeRangeBoundary.absolute(seconds=start_s),
            end=rr.TimeRangeBoundary.absolute(seconds=end_s),
        )
    )
    timeline = rrb.StateTimelineView(
        name="injected, broken, repaired",
        origin="/",
        contents=[f"+ /{INJECTED}/**", f"+ /{SYSTEMS}/**"],
        time_view=axis,
    )
    log = rrb.TextLogView(
        name="events",
        origin="events",
        columns=rrb.TextLogColumns(timeline_columns=["frame"], text_log_columns=["Body"]),
    )
    curves = [
        _curves(axis, "inliers", "inliers", _usual([float(r.inliers) for r in results]), len(kinds)),
        _curves(
            axis, "tracking, ms per frame", "ms", _usual([sum(r.ms.values()) for r in results]), len(kinds)
        ),
    ]
    direct = [kind for kind in kinds if residuals[kind]]
    if direct:
        known = [v for kind in direct for v in residuals[kind].values() if np.isfinite(v)]
        curves.append(_curves(axis, "residual, of 255", "residual", _usual(known or [0.0]), len(direct)))
    height = min(_MOST_LANES_PX, _LANES_PX + _LANE_PX * lanes)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                timeline,
                *curves,
                row_shares=[height, *[(_HEIGHT_PX - height) / len(curves)] * len(curves)],
            ),
            rrb.Vertical(
                rrb.Horizontal(*[_world_view(kind, view, eye) for kind in kinds]),
                key,
                rrb.Horizontal(*[_image_view(kind, *size, kind in direct) for kind in kinds]),
                log,
                row_shares=[12, 4 if direct else 3.2, 7, 5],
            ),
            column_shares=list(_COLUMNS),
        ),
        _time_panel(records),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _curves(axis: rrb.TimeAxis, name: str, plot: str, high: float, systems: int) -> rrb.TimeSeriesView:
    """Plot of one curve per system, with room for the legend above them."""
    return rrb.TimeSeriesView(
        name=name,
        origin=f"plots/{plot}",
        axis_x=axis,
        axis_y=rrb.ScalarAxis(range=(0.0, high)),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=systems > 1),
    )


def world_aspect(systems: int) -> float:
    """Width over height of the view of the world of one of some systems, on a screen of usual size."""
    return _WIDTH_PX / systems / _WORLD_PX


def _world_view(kind: str, view: Viewpoint, eye: tuple[np.ndarray, np.ndarray]) -> rrb.Spatial3DView:
    """3D view of one system."""
    return rrb.Spatial3DView(
        name=f"{kind}: path",
        origin="world",
        contents=["+ world", "+ world/true_path", "+ world/true_camera", f"+ world/{part(kind)}/**"],
        line_grid=rrb.LineGrid3D(color=_GRID),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye[0], look_target=eye[1], eye_up=view.up
        ),
    )


def _image_view(kind: str, width: float, height: float, direct: bool) -> rrb.Spatial2DView:
    shown = "residuals, green to red" if direct else "inliers in green"
    return rrb.Spatial2DView(
        name=f"{kind}: camera, {shown}",
        origin="camera",
        contents=["+ camera/image", f"+ camera/{part(kind)}/**"],
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def opening_s(records: Many[RunRecord]) -> tuple[float, float]:
    """Time from the first frame on with which a recording opens: about the first breakage, else all."""
    times_s = records[0].sequence.stamps_s - records[0].sequence.stamps_s[0]
    events = [event for record in records for event in record.events]
    broke = [float(times_s[e.frame]) for e in events if isinstance(e, Breakage)]
    broke = broke or [float(times_s[e.frame]) for e in events if isinstance(e, MapCut)]
    if not broke:
        return 0.0, float(times_s[-1])
    return max(0.0, min(broke) - _ABOUT_S), min(float(times_s[-1]), min(broke) + _ABOUT_S)


def _time_panel(records: Many[RunRecord]) -> rrb.TimePanel:
    start_s, end_s = opening_s(records)
    return rrb.TimePanel(
        state="collapsed",
        timeline="time",
        play_state="following",
        playback_speed=_SPEED,
        time_selection=rr.encodings.AbsoluteTimeRange(
            min=rr.encodings.TimeInt(seconds=start_s), max=rr.encodings.TimeInt(seconds=end_s)
        ),
    )


def _usual(values: list[float]) -> float:
    """Upper limit of a plot, above all but a few peaks, as of the first frame, which loads the kernels."""
    return max(1.0, 1.5 * float(np.percentile(values, 98)))
