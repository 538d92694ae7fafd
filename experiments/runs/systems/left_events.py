"""Events that a program has left, one JSON object per line as in the lab's ``events.jsonl``."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.runs.ending import Ending
from dslab.experiments.runs.systems.left_files import noted
from dslab.scenarios.input_files import TABLE_BYTES, is_given, read_text
from dslab.slam.core import events
from dslab.slam.core.events import Event
from dslab.slam.core.relation import PlacedFrames, Relation

_KINDS = {
    kind.kind: kind for kind in vars(events).values() if isinstance(kind, type) and issubclass(kind, Event)
}


def read_events(path: Path, frames: int, faults: list[Ending]) -> tuple[Event, ...]:
    """Read events, in order; none of a file that is malformed, of which ``faults`` gets what is wrong.

    Kinds and fields that are not known are left out, as a release may have others than today's lab.

    Args:
        path: the file; if there is none, there are no events.
        frames: number of frames that the program was given.
        faults: gets what is wrong with the file.
    """
    found = []
    if not is_given(path):
        return ()
    with noted(faults, path.name, "write the fields of `slam.events`"):
        for line in read_text(path, TABLE_BYTES).splitlines():
            try:
                row = json.loads(line)
                if row["event"] in _KINDS:
                    found.append(_event(_KINDS[row["event"]], row, frames))
            except (ValueError, TypeError, KeyError, RecursionError) as error:
                raise ValueError(f"{line[:60]!r} is no event ({error})") from None
        return tuple(found)
    return ()


def _event(kind: type[Event], row: dict[str, Any], frames: int) -> Event:
    """The event of a row. Raises ValueError, TypeError or KeyError if it is none."""
    types = {field.name: field.type for field in fields(kind)}
    values = {name: value for name, value in row.items() if name in types and name != "relation"}
    for name, value in values.items():
        if type(value) is not types[name] and not (types[name] is float and type(value) is int):
            raise ValueError(f"{name}: {value!r}"[:80])
    if row.get("relation") is not None:
        values["relation"] = _relation(row["relation"], frames)
    event = kind(**values)
    _check_frames([event.frame], frames)
    return event


def _relation(row: dict[str, Any], frames: int) -> Relation:
    return Relation(_placed(row["old"], frames), _placed(row["new"], frames), float(row["depth"]))


def _placed(row: dict[str, Any], frames: int) -> PlacedFrames:
    index = np.array(row["frames"], int)
    _check_frames(index, frames)
    poses = np.array(row["T_map_cam"], float).reshape(len(index), 4, 4)
    return PlacedFrames(index, np.array(row["stamps_s"], float).reshape(len(index)), poses)


def _check_frames(index: Any, frames: int) -> None:
    if any(not 0 <= frame < frames for frame in index):
        raise ValueError(f"is of no frame from 0 to {frames - 1}")
