"""The JSON Schema of scenario files, with the notation of distributions allowed for any node."""

from typing import Any

from dslab.scenarios.families import MEMBERS
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.scenarios.spec import Scenario

_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_FIXED = ("name", "description", "seed")
_BOUNDS = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
_NUMBERS = ("number", "integer")


def json_schema() -> dict[str, Any]:
    """The JSON Schema of a scenario file, be it of one scenario or of a family."""
    schema = Scenario.model_json_schema()
    for model in SEGMENT_KINDS.values():
        # Without it, a segment lasts to the end of the sequence.
        schema["$defs"][model.__name__]["required"].remove("duration_s")
    for model in [schema, *schema["$defs"].values()]:
        _let_vary(model)
    schema["$defs"]["Distribution"] = _distribution(True, {})
    fields = dict.fromkeys(set(schema["properties"]) - {"name"}, True)
    schema["properties"][MEMBERS] = {
        "type": "object",
        "description": "members by id: what each says differently, merged into the fields of the family",
        "minProperties": 1,
        "propertyNames": {"pattern": "^[a-z0-9][a-z0-9_-]*$"},
        "additionalProperties": {
            "type": ["object", "null"],
            "properties": dict(sorted(fields.items())),
            "additionalProperties": False,
        },
    }
    # What a family leaves to its members it need not say itself.
    schema["required"] = [name for name in schema["required"] if name != "world"]
    schema["anyOf"] = [{"required": ["world"]}, {"required": [MEMBERS]}]
    return {"$schema": _DRAFT, **schema}


def _let_vary(model: dict[str, Any]) -> None:
    """Allow a distribution for every property of a model and every item of its lists."""
    for name, plain in model.get("properties", {}).items():
        if name in _FIXED:
            continue
        if "items" in plain:
            plain["items"] = _varied(plain["items"])
        model["properties"][name] = _varied(plain)


def _varied(plain: dict[str, Any]) -> dict[str, Any]:
    about = {key: plain.pop(key) for key in ("title", "description", "default") if key in plain}
    if "oneOf" in plain:
        # Kinds tell the models apart: any that fits is the one.
        plain["anyOf"] = plain.pop("oneOf")
    number = plain.get("type") in _NUMBERS
    return {
        **about,
        "anyOf": [plain, _distribution(number, {"anyOf": [plain, {"$ref": "#/$defs/Distribution"}]})],
    }


def _distribution(number: bool, option: dict[str, Any]) -> dict[str, Any]:
    """The schema of a distribution whose options, if it is a choice, keep to a schema."""
    choice = {
        "type": "object",
        "properties": {
            "choice": {"type": "array", "items": option, "minItems": 1},
            "weights": {"type": "array", "items": {"type": "number", "minimum": 0}, "minItems": 1},
        },
        "required": ["choice"],
        "additionalProperties": False,
    }
    drawn = [
        {"type": "object", "properties": {key: _BOUNDS}, "required": [key], "additionalProperties": False}
        for key in ("uniform", "log_uniform")
    ]
    return {"anyOf": [*drawn, choice]} if number else choice
