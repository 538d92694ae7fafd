"""The kinds of degradation that recorded frames can have: keys, ranges with units, (defaults)."""

from collections.abc import Iterator
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from dslab.scenarios.describe import label_and_unit
from dslab.scenarios.segments import SEGMENT_KINDS, ImageSegment, SegmentBase
from dslab.sim.degradations.recorded_kinds import recording_lacks
from dslab.sim.degradations.registry import DEGRADATIONS

_OF_EVERY_KIND = ("kind", "start_s", "duration_s", "ramp_s", "fall_s")
_WORLD = "a world"
_WIDTHS = (18, 18, 7, None)


def described_kinds() -> Iterator[RenderableType]:
    """Yield the kinds that act on recordings, with their keys; 80 columns are enough."""
    for kind in _acting():
        model = SEGMENT_KINDS[kind]
        yield Text.assemble((kind, "bold"), "  ", _summary(model))
        yield _keys(model)
    plain = [kind for kind in _acting() if not issubclass(SEGMENT_KINDS[kind], ImageSegment)]
    yield (
        "Every kind has start_s and duration_s, in seconds from the first frame, and all but "
        f"{', '.join(plain)} have ramp_s, the time in which the severity rises "
        "and falls (fall_s, if it falls in another)."
    )
    others = [kind for kind in DEGRADATIONS if kind not in _acting()]
    yield f"In rendered scenarios only: {', '.join(others)}."


def _keys(model: type[SegmentBase]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for width in _WIDTHS:
        table.add_column(width=width)
    for name, key in model.model_json_schema()["properties"].items():
        default = key.get("default", "")
        if name not in _OF_EVERY_KIND and default is not None:  # what is off is of rendered scenarios
            shown = default if isinstance(default, str) else f"{default:g}"
            table.add_row(f"  {name}", _range(name, key), shown and f"({shown})", key.get("description", ""))
    return table


def _acting() -> list[str]:
    return [kind for kind in DEGRADATIONS if recording_lacks(kind) != _WORLD]


def _range(name: str, key: dict[str, Any]) -> str:
    """Range of a key's values, with their unit."""
    if "enum" in key:
        return ", ".join(map(str, key["enum"]))
    low, high = key.get("minimum", key.get("exclusiveMinimum")), key.get("maximum")
    unit = label_and_unit(name)[1]
    if low is None:
        return ""
    from_low = f"above {low:g}" if "exclusiveMinimum" in key else f"{low:g}"
    return f"{from_low} to {high:g}{unit}" if high is not None else f"from {from_low}{unit}"


def _summary(model: type[SegmentBase]) -> str:
    """What a kind does to recordings: the last paragraph of its description."""
    paragraph = (model.__doc__ or "").split("\n\n")[-1]
    return " ".join(paragraph.split()).removeprefix("In recordings: ")
