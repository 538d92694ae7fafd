"""The base of every part of a spec."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """Base of every part of a spec: frozen, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def with_defaults_of(data: Any, key: str, defaults: Mapping[str, Mapping[str, Any]]) -> Any:
    """Put the data of a spec's part over the defaults selected by its ``key``.

    Args:
        data: of any type; without a known name under ``key`` it is returned unchanged.
        key: the field that holds the name.
        defaults: fields by name.
    """
    name = data.get(key) if isinstance(data, dict) else None
    return {**defaults[name], **data} if isinstance(name, str) and name in defaults else data
