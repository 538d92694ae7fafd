"""A series of doses in the stress of a batch: one field of one segment that is a list."""

import re
from collections.abc import Sequence as Many
from dataclasses import dataclass
from typing import get_args, get_origin

from dslab.scenarios.describe import describe_field
from dslab.scenarios.errors import InputError
from dslab.scenarios.segment_text import parse_segment
from dslab.scenarios.segments import SEGMENT_KINDS

_LIST = re.compile(r"(\w+)\s*=\s*\[([^\[\]]*)\]")


@dataclass(frozen=True)
class DoseSeries:
    """The doses of a stress.

    Attributes:
        kind, field: the segment and its field that varies.
        stresses: per dose all segments of the stress, as texts.
        pattern: the stress without its doses.
    """

    kind: str
    field: str
    stresses: dict[float, tuple[str, ...]]
    pattern: tuple[str, ...]

    @property
    def about(self) -> tuple[str, str]:
        """The segment and its field."""
        return self.kind, self.field

    def label(self, dose: float) -> str:
        """A dose in words: ``exposure 0.1 s``."""
        return describe_field(self.field, dose)


def dose_series(stress: Many[str]) -> DoseSeries | None:
    """The doses of a stress; None where no field that takes one number is a list.

    Args:
        stress: segments, ``motion_blur:start_s=20,duration_s=1,exposure_s=[0.02,0.05,0.1]`` for three doses.

    Raises:
        InputError: several fields are such lists, a dose is no number, or is given twice.
    """
    found = [(place, lists) for place, text in enumerate(stress) for lists in _LIST.finditer(text)]
    found = [(place, match) for place, match in found if _is_dose(stress[place], match[1])]
    if not found:
        return None
    place, match = found[0]
    where = f"segment {stress[place]!r}: {match[1]}"
    if len(found) > 1:
        raise InputError(where, "is not the only list of doses", "give one field a list")
    doses: dict[float, str] = {}
    for word in (word.strip() for word in match[2].split(",")):
        try:
            dose = float(word)
        except ValueError:
            raise InputError(where, f"{word!r} is no number", "give doses, as [0.02,0.1]") from None
        if dose in doses:
            raise InputError(where, f"{word} is given twice", "give each dose once")
        doses[dose] = word

    def with_dose(value: str) -> tuple[str, ...]:
        text = f"{stress[place][: match.start()]}{match[1]}={value}{stress[place][match.end() :]}"
        return (*stress[:place], text, *stress[place + 1 :])

    kind = parse_segment(with_dose(next(iter(doses.values())))[place]).kind
    stresses = {dose: with_dose(word) for dose, word in sorted(doses.items())}
    return DoseSeries(kind, match[1], stresses, with_dose("*"))


def _is_dose(text: str, field: str) -> bool:
    """True if a field of a segment takes one value: a list of it is a series."""
    model = SEGMENT_KINDS.get(text.partition(":")[0].strip())
    known = model.model_fields.get(field) if model else None
    if known is None:
        return False
    return not any(
        get_origin(part) in (tuple, list) for part in (known.annotation, *get_args(known.annotation))
    )
