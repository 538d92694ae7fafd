"""Layout of a recording: systems side by side, lanes and curves over a shared time."""

from collections.abc import Sequence as Many

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from experiments.evaluation.scene import Scene
from experiments.recording.stream import part
from experiments.runs.execution import RunRecord
from slam.core.events import Breakage

_BEFORE_S, _AFTER_S = 1.0, 6.0
"""Selected time around the first breakage."""
_GRID = (255, 255, 255, 10)
_SHARED_TIME = rrb.TimeAxis(link="linktoglobal")


def make_blueprint(records: Many[RunRecord], scene: Scene, shrink: float) -> rrb.Blueprint:
    """Make the layout for runs over one sequence.

    A blueprint cannot set the time cursor. It opens at the end of the recording, with the time around the
    first breakage selected; :func:`experiments.recording.viewer.open_viewer` sets the cursor on the breakage.

    Args:
        records: one run per system.
        scene: common scene of all runs.
        shrink: scale of the recorded images relative to the input images.
    """
    camera = records[0].sequence.camera
    size = camera.width_px * shrink, camera.height_px * shrink
    kinds = [record.system_kind for record in records]
    lanes = rrb.StateTimelineView(name="states", origin="lanes", time_view=_SHARED_TIME)
    inliers = rrb.TimeSeriesView(name="inliers", origin="plots/inliers", axis_x=_SHARED_TIME)
    ms = rrb.TimeSeriesView(
        name="tracking, ms per frame",
        origin="plots/ms",
        axis_x=_SHARED_TIME,
        axis_y=rrb.ScalarAxis(range=(0.0, _usual_ms(records))),
    )
    log = rrb.TextLogView(
        name="events",
        origin="events",
        columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=["LogLevel", "Body"]),
    )
    rows = 3 * len(records) + 2
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(lanes, inliers, ms, row_shares=[rows, 4, 4]),
            rrb.Vertical(
                rrb.Horizontal(*[_world_view(kind, scene) for kind in kinds]),
                rrb.Horizontal(*[_image_view(kind, *size) for kind in kinds]),
                log,
                row_shares=[10, 7, 6],
            ),
            column_shares=[6, 8],
        ),
        _time_panel(records),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _world_view(kind: str, scene: Scene) -> rrb.Spatial3DView:
    """3D view of one system, framed on the path."""
    across = np.roll(np.abs(scene.up), 1) * 0.8 + np.roll(np.abs(scene.up), 2) * 0.6
    eye = scene.centre + scene.extent * (1.15 * scene.up - 0.55 * across)
    title = "map, aligned to the truth for display" if scene.T_world_cam is not None else "map"
    return rrb.Spatial3DView(
        name=f"{kind}: {title}",
        origin="world",
        contents=["+ world", "+ world/true_path", "+ world/true_camera", f"+ world/{part(kind)}/**"],
        line_grid=rrb.LineGrid3D(color=_GRID),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=scene.centre, eye_up=scene.up
        ),
    )


def _image_view(kind: str, width: float, height: float) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        name=f"{kind}: camera, inliers in green",
        origin="camera",
        contents=["+ camera/image", f"+ camera/{part(kind)}/**"],
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def _time_panel(records: Many[RunRecord]) -> rrb.TimePanel:
    stamps_s = records[0].sequence.stamps_s
    broke = [e.stamp_s for r in records for e in r.events if isinstance(e, Breakage)]
    if not broke:
        return rrb.TimePanel(state="collapsed", timeline="time")
    start_s = max(float(stamps_s[0]), min(broke) - _BEFORE_S)
    end_s = min(float(stamps_s[-1]), min(broke) + _AFTER_S)
    return rrb.TimePanel(
        state="collapsed",
        timeline="time",
        play_state="following",
        time_selection=rr.encodings.AbsoluteTimeRange(
            min=rr.encodings.TimeInt(seconds=start_s), max=rr.encodings.TimeInt(seconds=end_s)
        ),
    )


def _usual_ms(records: Many[RunRecord]) -> float:
    """Upper limit of the time plot, without the first frame, which loads the kernels."""
    times = [sum(r.ms.values()) for record in records for r in record.results]
    return max(1.0, 1.5 * float(np.percentile(times, 98)))
