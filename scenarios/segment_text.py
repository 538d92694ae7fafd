"""Segments on a command line: ``low_light:start_s=2,duration_s=1,illumination=0.1``.

The value of a field that holds several is a list: ``tint:start_s=2,duration_s=1,gains=[1,0.9,0.8]``.
"""

import re
from typing import Any

from pydantic import ValidationError

from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import OWN_KIND, guess, problem_and_remedy
from dslab.scenarios.segments import SEGMENT_KINDS, SegmentBase

# Commas within a list part its values.
_PARTS = re.compile(r",(?![^\[\]]*\])")


def parse_segment(text: str) -> SegmentBase:
    """Parse a segment from ``kind:key=value,key=[value,value]``.

    Raises:
        InputError: the kind or a key is unknown, a key is missing or given twice, a value is out of range.
    """
    kind, _, rest = text.partition(":")
    kind = kind.strip()
    if kind not in SEGMENT_KINDS:
        kinds = list(SEGMENT_KINDS)
        raise InputError(
            f"segment {text!r}",
            f"unknown kind {kind!r}",
            f"use {guess(kind, kinds)}one of {', '.join(kinds)}{OWN_KIND}",
        )
    model = SEGMENT_KINDS[kind]
    values: dict[str, Any] = {"kind": kind}
    for part in filter(None, (part.strip() for part in _PARTS.split(rest))):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not value:
            raise InputError(f"segment {text!r}: {part}", "is no key=value", "write for example start_s=2")
        if key in values:
            raise InputError(f"segment {text!r}: {key}", "is given twice", "keep one of them")
        values[key] = _value(value)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _invalid(text, model, error) from None


def _value(text: str) -> str | list[str]:
    """A value, or those of a list."""
    if not (text.startswith("[") and text.endswith("]")):
        return text
    return [word.strip() for word in text[1:-1].split(",")] if text[1:-1].strip() else []


def _invalid(text: str, model: type[SegmentBase], error: ValidationError) -> InputError:
    # A misspelt key also shows as a missing one: name the misspelling.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    key = ".".join(map(str, first["loc"]))
    where = f"segment {text!r}" + (f": {key}" if key else "")
    if first["type"] == "extra_forbidden":
        allowed = [name for name in model.model_fields if name != "kind"]
        return InputError(where, "unknown key", f"use {guess(key, allowed)}one of {', '.join(allowed)}")
    return InputError(where, *problem_and_remedy(first))
