"""Events that a program has left, one JSON object per line as in the lab's ``events.jsonl``."""

import json
from dataclasses import fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.runs.ending import Ending
from dslab.experiments.runs.systems.left_files import no_rotations, noted
from dslab.scenarios.input_files import TABLE_BYTES, is_given, read_text
from dslab.slam.core import events
from dslab.slam.core.events import Event, Relocalized
from dslab.slam.core.relation import PlacedFrames, Relation

EVENT_FAULTS = (ValueError, TypeError, AttributeError, OverflowError)
"""What is raised for an event that is none."""
STAMP_TOLERANCE_S = 1e-3
"""Largest difference of the times of a frame, as of the truth's pairs."""
_MOST_NUMBER = 2**53
_SIDE = ("frames", "stamps_s", "T_map_cam")
_PLAIN: dict[Any, Any] = {
    int: int | np.integer,
    float: int | float | np.integer | np.floating,
    bool: bool | np.bool_,
    str: str,
}
_KINDS = {
    kind.kind: kind for kind in vars(events).values() if isinstance(kind, type) and issubclass(kind, Event)
}


def read_events(path: Path, stamps_s: np.ndarray, faults: list[Ending]) -> tuple[Event, ...]:
    """Read events, in order; none of a file that is malformed, of which ``faults`` gets what is wrong.

    Kinds and fields that are not known are left out, as a release may have others than today's lab.

    Args:
        path: the file; if there is none, there are no events.
        stamps_s: (N,) times of the frames that the program was given.
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
                    found.append(checked_event(_event(_KINDS[row["event"]], row), stamps_s))
            except (*EVENT_FAULTS, KeyError, RecursionError) as error:
                raise ValueError(f"{line[:60]!r} is no event ({error})") from None
        return tuple(found)
    return ()


def checked_event(event: Any, stamps_s: np.ndarray) -> Event:
    """The event with plain values, as everything that reads a run expects it.

    Args:
        event: of one of the classes in ``slam.events``; its values may be of any kind.
        stamps_s: (N,) times of the frames.

    Raises:
        EVENT_FAULTS: it is of no frame or of no such class, or a value is none of its field.
    """
    if type(event) not in _KINDS.values():
        raise TypeError(f"{type(event).__name__} is no kind of event")
    types = {field.name: field.type for field in fields(event)}
    values = {name: _plain(name, getattr(event, name), of) for name, of in types.items() if of in _PLAIN}
    _check_frames([values["frame"]], len(stamps_s))
    if (relation := getattr(event, "relation", None)) is not None:
        old, new = (_placed(side, stamps_s) for side in (relation.old, relation.new))
        if isinstance(event, Relocalized) and not len(new.frames):
            raise ValueError("relation: without the relocalized frame")
        values["relation"] = Relation(old, new, _plain("depth", relation.depth, float))
    return replace(event, **values)


def _event(kind: type[Event], row: dict[str, Any]) -> Event:
    """The event of a row, with values of any kind. Raises TypeError or KeyError if it is none."""
    names = {field.name for field in fields(kind)} - {"placed"}
    values = {name: value for name, value in row.items() if name in names}
    if (said := row.get("relation")) is not None:
        old, new = (PlacedFrames(*(side[n] for n in _SIDE)) for side in (said["old"], said["new"]))
        values["relation"] = Relation(old, new, said["depth"])
    return kind(**values)


def _plain(name: str, value: Any, of: Any) -> Any:
    """A value of a plain type. Raises ValueError or OverflowError for any other."""
    is_one = isinstance(value, _PLAIN[of]) and (of is bool or not isinstance(value, bool))
    plain = of(value) if is_one else None
    if plain is None or (of is int and abs(plain) > _MOST_NUMBER) or (of is float and not isfinite(plain)):
        raise ValueError(f"{name}: {value!r}"[:80])
    if name.endswith("_ms") and plain < 0:
        raise ValueError(f"{name}: {value!r} is below 0")
    return plain


def _placed(side: PlacedFrames, stamps_s: np.ndarray) -> PlacedFrames:
    index = np.array(side.frames, int)
    _check_frames(index, len(stamps_s))
    poses = np.array(side.T_map_cam, float).reshape(len(index), 4, 4)
    times_s = np.array(side.stamps_s, float).reshape(len(index))
    if not (np.abs(times_s - stamps_s[index]) <= STAMP_TOLERANCE_S).all():
        raise ValueError("relation: a frame has another time")
    if not np.isfinite(poses).all() or no_rotations(poses).any():
        raise ValueError("relation: a pose is no rigid transform")
    return PlacedFrames(index, times_s, poses)


def _check_frames(index: Any, frames: int) -> None:
    if any(not 0 <= frame < frames for frame in index):
        raise ValueError(f"is of no frame from 0 to {frames - 1}")
