"""The base of every part of a spec."""

from collections.abc import Mapping
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError


class Strict(BaseModel):
    """Base of every part of a spec: frozen, unknown keys are errors, in copies too."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with other fields, which are checked as those of a file are.

        Raises:
            InputError: a field is unknown, or the fields are not valid together; with every fault.
        """
        if update:
            fields = {name: getattr(self, name) for name in type(self).model_fields}
            try:
                checked = type(self).model_validate(fields | dict(update))
            except ValidationError as error:
                from dslab.scenarios.faults import all_faults

                raise all_faults(error, self._place, root=type(self)) from None
            update = {name: getattr(checked, name) for name in update}
        return super().model_copy(update=update, deep=deep)

    def _place(self, location: tuple[str | int, ...]) -> str:
        return ".".join([type(self).__name__, *map(str, location)])


def with_defaults_of(data: Any, key: str, defaults: Mapping[str, Mapping[str, Any]]) -> Any:
    """Put the data of a spec's part over the defaults selected by its ``key``.

    Args:
        data: of any type; without a known name under ``key`` it is returned unchanged.
        key: the field that holds the name.
        defaults: fields by name.
    """
    name = data.get(key) if isinstance(data, dict) else None
    return {**defaults[name], **data} if isinstance(name, str) and name in defaults else data
