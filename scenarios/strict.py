"""The base of every part of a spec."""

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, model_serializer


class Strict(BaseModel):
    """Base of every part of a spec: frozen, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Grown(Strict):
    """Base of a part that has been given fields since; ``_unwritten`` holds these with their defaults."""

    _unwritten: ClassVar[dict[str, Any]] = {}

    @model_serializer(mode="wrap")
    def _without_what_is_off(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out younger fields that are off: what is identified by its content stays the same."""
        data = handler(self)
        return {k: v for k, v in data.items() if k not in self._unwritten or v != self._unwritten[k]}


def with_defaults_of(data: Any, key: str, defaults: Mapping[str, Mapping[str, Any]]) -> Any:
    """Put the data of a spec's part over the defaults selected by its ``key``.

    Args:
        data: of any type; without a known name under ``key`` it is returned unchanged.
        key: the field that holds the name.
        defaults: fields by name.
    """
    name = data.get(key) if isinstance(data, dict) else None
    return {**defaults[name], **data} if isinstance(name, str) and name in defaults else data
