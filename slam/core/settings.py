"""Settings described where they are: default, meaning, unit and bounds of each field."""

import math
from typing import Annotated, Any, TypeVar, dataclass_transform

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

T = TypeVar("T")

GREY = "grey levels"
DEPTHS = "median depths"
# Far beyond every sensible setting, and within the integers and floats of the kernels.
MOST = 1e6

Whole = Annotated[int, Field(ge=0, le=MOST)]
"""An integer within a setting of several."""
Real = Annotated[float, Field(ge=0, le=MOST)]
"""A number within a setting of several."""


@dataclass_transform(frozen_default=True)
def settings(cls: type[T]) -> type[T]:
    """Make a class of settings: a frozen dataclass that refuses unknown names, wrong types and bounds."""
    frozen: Any = dataclass(frozen=True, config=ConfigDict(strict=True, extra="forbid"))
    return frozen(cls)


def setting(default: T, meaning: str, *, unit: str = "", le: float = MOST, **bounds: float) -> T:
    """Declare a field of settings.

    Args:
        default: its value unless another one is given.
        meaning: what it is, in a line.
        unit: where no ending of the name says it, such as ``_px``.
        le: largest value; infinity, if it may be that.
        bounds: ``ge``, ``gt`` or ``lt`` as of ``pydantic.Field``; a number is 0 or more if none is given.
    """
    if isinstance(default, bool) or not isinstance(default, int | float):
        return Field(default, description=meaning)
    bounds = (bounds or {"ge": 0}) | ({"le": le} if le < math.inf else {})
    return Field(default, description=meaning, json_schema_extra={"unit": unit} if unit else None, **bounds)
