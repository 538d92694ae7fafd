"""Layout of a recording: systems side by side, lanes and curves over a shared time."""

from collections.abc import Sequence as Many

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dslab.experiments.evaluation.scene import Scene
from dslab.experiments.recording.drawing import INJECTED, SYSTEMS
from dslab.experiments.recording.stream import part
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Breakage

_HEIGHT_PX, _LANES_PX, _LANE_PX, _MOST_LANES_PX = 800, 56, 40, 560
"""Heights on a screen of usual size: of all, of the head of the timeline, of a lane, of the timeline."""
_BEFORE_S, _AFTER_S = 1.0, 6.0
"""Selected time around the first breakage."""
_GRID = (255, 255, 255, 10)
_SHARED_TIME = rrb.TimeAxis(link="linktoglobal")


def make_blueprint(
    records: Many[RunRecord],
    scene: Scene,
    shrink: float,
    lanes: int,
    residuals: dict[str, dict[int, float]],
    key: rrb.Spatial2DView,
) -> rrb.Blueprint:
    """Make the layout for runs over one sequence.

    A blueprint cannot set the time cursor. It opens at the end of the recording, with the time around the
    first breakage selected; :func:`experiments.recording.viewer.open_viewer` sets the cursor on the breakage.

    Args:
        records: one run per system.
        scene: common scene of all runs.
        shrink: scale of the recorded images relative to the input images.
        lanes: number of lanes of the timeline.
        residuals: root mean square by frame, of every system; empty unless it is a direct one.
        key: view of the key of the colours.
    """
    camera = records[0].sequence.camera
    size = camera.width_px * shrink, camera.height_px * shrink
    kinds = [record.system_kind for record in records]
    results = [result for record in records for result in record.results]
    timeline = rrb.StateTimelineView(
        name="injected, broken, repaired",
        origin="/",
        contents=[f"+ /{INJECTED}/**", f"+ /{SYSTEMS}/**"],
        time_view=_SHARED_TIME,
    )
    log = rrb.TextLogView(
        name="events",
        origin="events",
        columns=rrb.TextLogColumns(timeline_columns=["frame"], text_log_columns=["Body"]),
    )
    curves = [
        _curves("inliers", "inliers", _usual([float(r.inliers) for r in results]), len(kinds)),
        _curves("tracking, ms per frame", "ms", _usual([sum(r.ms.values()) for r in results]), len(kinds)),
    ]
    direct = [kind for kind in kinds if residuals[kind]]
    if direct:
        known = [v for kind in direct for v in residuals[kind].values() if np.isfinite(v)]
        curves.append(_curves("residual, of 255", "residual", _usual(known or [0.0]), len(direct)))
    height = min(_MOST_LANES_PX, _LANES_PX + _LANE_PX * lanes)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                timeline,
                *curves,
                row_shares=[height, *[(_HEIGHT_PX - height) / len(curves)] * len(curves)],
            ),
            rrb.Vertical(
                rrb.Horizontal(*[_world_view(kind, scene) for kind in kinds]),
                key,
                rrb.Horizontal(*[_image_view(kind, *size, kind in direct) for kind in kinds]),
                log,
                row_shares=[9, 4 if direct else 2.6, 7, 5],
            ),
            column_shares=[6, 8],
        ),
        _time_panel(records),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _curves(name: str, plot: str, high: float, systems: int) -> rrb.TimeSeriesView:
    """Plot of one curve per system, with room for the legend above them."""
    return rrb.TimeSeriesView(
        name=name,
        origin=f"plots/{plot}",
        axis_x=_SHARED_TIME,
        axis_y=rrb.ScalarAxis(range=(0.0, high)),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=systems > 1),
    )


def _world_view(kind: str, scene: Scene) -> rrb.Spatial3DView:
    """3D view of one system, framed on the path, the longer side of which lies across."""
    eye = scene.centre + scene.extent * (0.9 * scene.up - 0.95 * _short_side(scene))
    title = "path, aligned to the truth" if scene.T_world_cam is not None else "path"
    return rrb.Spatial3DView(
        name=f"{kind}: {title}",
        origin="world",
        contents=["+ world", "+ world/true_path", "+ world/true_camera", f"+ world/{part(kind)}/**"],
        line_grid=rrb.LineGrid3D(color=_GRID),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=scene.centre, eye_up=scene.up
        ),
    )


def _short_side(scene: Scene) -> np.ndarray:
    """(3,) unit vector across the true path on the ground; any on the ground without truth."""
    ground = np.eye(3)[scene.up == 0]
    truth = np.empty((0, 4, 4)) if scene.T_world_cam is None else scene.T_world_cam
    places = truth[np.isfinite(truth).all(axis=(1, 2)), :3, 3] @ ground.T
    places = places - places.mean(axis=0) if len(places) else places
    return np.linalg.eigh(places.T @ places)[1][:, 0] @ ground


def _image_view(kind: str, width: float, height: float, direct: bool) -> rrb.Spatial2DView:
    shown = "residuals, green to red" if direct else "inliers in green"
    return rrb.Spatial2DView(
        name=f"{kind}: camera, {shown}",
        origin="camera",
        contents=["+ camera/image", f"+ camera/{part(kind)}/**"],
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def _time_panel(records: Many[RunRecord]) -> rrb.TimePanel:
    times_s = records[0].sequence.stamps_s - records[0].sequence.stamps_s[0]
    broke = [float(times_s[e.frame]) for r in records for e in r.events if isinstance(e, Breakage)]
    if not broke:
        return rrb.TimePanel(state="collapsed", timeline="time")
    start_s = max(0.0, min(broke) - _BEFORE_S)
    end_s = min(float(times_s[-1]), min(broke) + _AFTER_S)
    return rrb.TimePanel(
        state="collapsed",
        timeline="time",
        play_state="following",
        time_selection=rr.encodings.AbsoluteTimeRange(
            min=rr.encodings.TimeInt(seconds=start_s), max=rr.encodings.TimeInt(seconds=end_s)
        ),
    )


def _usual(values: list[float]) -> float:
    """Upper limit of a plot, above all but a few peaks, as of the first frame, which loads the kernels."""
    return max(1.0, 1.5 * float(np.percentile(values, 98)))
