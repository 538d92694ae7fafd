"""Key of the colours, as a view of its own."""

import rerun as rr
import rerun.blueprint as rrb

from experiments.recording import palette
from experiments.recording.stream import Stream

_ENTITY = "key"
_COLUMNS, _STEP = 4, (150.0, 34.0)


def draw_key(stream: Stream) -> None:
    """Draw a dot with a label per colour."""
    places = [
        (_STEP[0] * (k % _COLUMNS + 0.5), _STEP[1] * (k // _COLUMNS + 0.3)) for k in range(len(palette.KEY))
    ]
    dots = rr.Points2D(
        places,
        colors=list(palette.KEY.values()),
        labels=list(palette.KEY),
        show_labels=True,
        radii=rr.Radius.ui_points(5.0),
    )
    stream.static(_ENTITY, dots)


def key_view() -> rrb.Spatial2DView:
    """View of the key."""
    rows = -(-len(palette.KEY) // _COLUMNS)
    return rrb.Spatial2DView(
        name="colours",
        origin=_ENTITY,
        visual_bounds=rrb.VisualBounds2D(x_range=(0, _COLUMNS * _STEP[0]), y_range=(0, rows * _STEP[1])),
    )
