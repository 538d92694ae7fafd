"""A segment as one word of a command line: ``low_light:start_s=2,duration_s=1,illumination=0.1``."""

from difflib import get_close_matches
from typing import Any, get_args

from pydantic import ValidationError

from scenarios.errors import InputError
from scenarios.segments import Segment, SegmentBase

SEGMENT_MODELS: dict[str, type[SegmentBase]] = {
    get_args(model.model_fields["kind"].annotation)[0]: model for model in get_args(get_args(Segment)[0])
}
"""The model of every kind of segment."""


def parse_segment(text: str) -> SegmentBase:
    """A segment from ``kind:key=value,key=value``.

    Raises:
        InputError: the kind or a key is unknown, a key is missing or given twice, a value is out of range.
    """
    kind, _, rest = text.partition(":")
    kind = kind.strip()
    if kind not in SEGMENT_MODELS:
        kinds = list(SEGMENT_MODELS)
        raise InputError(
            f"segment {text!r}",
            f"unknown kind {kind!r}",
            f"use {_guess(kind, kinds)}one of {', '.join(kinds)}",
        )
    model = SEGMENT_MODELS[kind]
    values: dict[str, Any] = {"kind": kind}
    for part in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not value:
            raise InputError(f"segment {text!r}: {part}", "is no key=value", "write for example start_s=2")
        if key in values:
            raise InputError(f"segment {text!r}: {key}", "is given twice", "keep one of them")
        values[key] = value
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _invalid(text, model, error) from None


def _invalid(text: str, model: type[SegmentBase], error: ValidationError) -> InputError:
    # A misspelt key also shows as a missing one: name the misspelling.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    key = ".".join(map(str, first["loc"]))
    where = f"segment {text!r}" + (f": {key}" if key else "")
    if first["type"] == "extra_forbidden":
        allowed = [name for name in model.model_fields if name != "kind"]
        return InputError(where, "unknown key", f"use {_guess(key, allowed)}one of {', '.join(allowed)}")
    if first["type"] == "missing":
        return InputError(where, "is missing", "add it")
    if first["type"] == "value_error":
        problem, _, remedy = str(first.get("ctx", {})["error"]).rpartition(", ")
        return InputError(where, problem, remedy)
    return InputError(where, f"{first['input']!r} is not valid", first["msg"][0].lower() + first["msg"][1:])


def _guess(given: str, allowed: list[str]) -> str:
    close = get_close_matches(given, allowed, n=1, cutoff=0.5)
    return f"{close[0]} (did you mean that?), or " if close else ""
