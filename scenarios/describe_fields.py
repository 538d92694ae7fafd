"""Fields of a model as text: defaults, ranges with units, meanings, as its JSON Schema has them."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from dslab.scenarios.describe import label_and_unit


def described_fields(model: type[BaseModel], without: tuple[str, ...] = ()) -> Iterator[tuple[str, str, str]]:
    """Name of each field, its default and range, and its meaning; the unit is read off a name's ending."""
    schema = model.model_json_schema()
    for name, field in schema["properties"].items():
        if name not in without:
            default = "required" if name in schema.get("required", ()) else _default(field.get("default"))
            span = f"{_range(field)} {label_and_unit(name)[1].strip()}".strip()
            yield name, "; ".join(filter(None, (default, span))), field.get("description", "")


def _default(value: object) -> str:
    """A default as written in YAML; nothing for one that is made by the model or left out."""
    if isinstance(value, bool):
        return f"default `{value}`".lower()
    if value and isinstance(value, list) and all(isinstance(one, str | int | float) for one in value):
        return f"default `[{', '.join(map(str, value))}]`"
    return f"default `{value}`" if isinstance(value, str | int | float) and value != "" else ""


def _range(field: Mapping[str, Any]) -> str:
    nodes = (field, *field.get("anyOf", ()))
    if options := next((node["enum"] for node in nodes if "enum" in node), None):
        return f"one of {', '.join(f'`{option}`' for option in options)}"
    bounds = next((node for node in nodes if {"minimum", "exclusiveMinimum"} & set(node)), {})
    above, least = bounds.get("exclusiveMinimum"), bounds.get("minimum", "")
    below, most = bounds.get("exclusiveMaximum"), bounds.get("maximum", "")
    high = str(most) if below is None else f"below {below:g}"
    high = "" if high == str(2**63 - 1) else high  # that of any whole number
    if above is not None:
        return f"above {above:g} to {high}" if high else f"above {above:g}"
    return f"{least} to {high}" if str(least) and high else f"from {least}" if str(least) else high
