"""Key of the colours, as a view of its own."""

import rerun as rr
import rerun.blueprint as rrb

from dslab.experiments.recording.palette import Color
from dslab.experiments.recording.stream import Stream

COLUMNS = 5
_ENTITY, _STEP = "key", (160.0, 28.0)


def draw_key(stream: Stream, meanings: dict[str, Color]) -> rrb.Spatial2DView:
    """Draw a dot with a label per colour; returns the view of them."""
    places = [(_STEP[0] * (k % COLUMNS + 0.5), _STEP[1] * (k // COLUMNS + 0.3)) for k in range(len(meanings))]
    stream.static(
        _ENTITY,
        rr.Points2D(
            places, colors=list(meanings.values()), labels=list(meanings), show_labels=True,
            radii=rr.Radius.ui_points(5.0),
        ),
    )  # fmt: skip
    height = -(-len(meanings) // COLUMNS) * _STEP[1]
    bounds = rrb.VisualBounds2D(x_range=(0, COLUMNS * _STEP[0]), y_range=(0, height))
    return rrb.Spatial2DView(name="colours", origin=_ENTITY, visual_bounds=bounds)
