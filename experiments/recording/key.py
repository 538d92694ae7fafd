"""Key of the colours, as a view of its own."""

import rerun as rr
import rerun.blueprint as rrb

from dslab.experiments.recording import palette
from dslab.experiments.recording.stream import Stream

_ENTITY = "key"
_COLUMNS, _STEP = 4, (150.0, 34.0)


def key(direct: bool) -> dict[str, palette.Color]:
    """Colours by their meaning, with those of direct systems if there are any."""
    return palette.KEY | palette.DIRECT_KEY if direct else palette.KEY


def draw_key(stream: Stream, direct: bool) -> None:
    """Draw a dot with a label per colour."""
    meanings = key(direct)
    places = [
        (_STEP[0] * (k % _COLUMNS + 0.5), _STEP[1] * (k // _COLUMNS + 0.3)) for k in range(len(meanings))
    ]
    dots = rr.Points2D(
        places,
        colors=list(meanings.values()),
        labels=list(meanings),
        show_labels=True,
        radii=rr.Radius.ui_points(5.0),
    )
    stream.static(_ENTITY, dots)


def key_rows(direct: bool) -> int:
    """Number of rows of the key."""
    return -(-len(key(direct)) // _COLUMNS)


def key_view(direct: bool) -> rrb.Spatial2DView:
    """View of the key."""
    rows = key_rows(direct)
    return rrb.Spatial2DView(
        name="colours",
        origin=_ENTITY,
        visual_bounds=rrb.VisualBounds2D(x_range=(0, _COLUMNS * _STEP[0]), y_range=(0, rows * _STEP[1])),
    )
