"""Scenarios from YAML files and by name; every fault of a file is one clear line."""

import json
from collections.abc import Iterator
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ValidationError

from scenarios.errors import InputError
from scenarios.spec import Scenario

FAMILIES_DIR = Path(__file__).parent / "families"
_SUFFIXES = (".yaml", ".yml")

Location = tuple[str | int, ...]


@cache
def named_scenarios() -> dict[str, Path]:
    """The scenarios that come with the package: name to YAML file, sorted by name."""
    return {path.stem: path for path in sorted(FAMILIES_DIR.glob("*.yaml"))}


def load_scenario(path_or_name: str | Path) -> Scenario:
    """A scenario by name, or from a YAML file.

    Args:
        path_or_name: one of ``named_scenarios()``, or the path of a YAML file.

    Raises:
        InputError: no such name or file, no YAML, or content that is no valid scenario.
    """
    text = str(path_or_name)
    if text in named_scenarios():
        return load_scenario_file(named_scenarios()[text])
    path = Path(path_or_name)
    if path.suffix in _SUFFIXES or path.exists():
        return load_scenario_file(path)
    names = list(named_scenarios())
    raise InputError(
        text,
        "no such scenario",
        f"use {_guess(text, names)}one of {', '.join(names)}, or the path of a .yaml file",
    )


def load_scenario_file(path: Path) -> Scenario:
    """A scenario from one YAML file. Raises InputError as ``load_scenario`` does."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(str(path), "no such file", "check the path, or see `dslab scenarios list`") from None
    except UnicodeDecodeError:
        raise InputError(str(path), "is not UTF-8 text", "give a YAML file") from None
    except OSError as error:
        raise InputError(str(path), error.strerror or "cannot be read", "give a readable YAML file") from None
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise _not_yaml(path, error) from None
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), f"is not valid YAML ({error})", "correct the value") from None
    if not isinstance(data, dict) or root is None:
        raise InputError(str(path), "holds no scenario", "start from `dslab scenarios show clean-room`")
    for location, node in _duplicate_keys(root):
        raise InputError(_where(path, root, location, node), "key appears twice", "keep one of them")
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise _invalid(path, root, error) from None


def json_schema() -> dict[str, Any]:
    """The JSON Schema of a scenario file."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Scenario.model_json_schema()}


def dump_yaml(scenario: Scenario) -> str:
    """The scenario with every default written out, as YAML that ``load_scenario`` reads back."""
    return yaml.safe_dump(json.loads(scenario.model_dump_json()), sort_keys=False, allow_unicode=True)


def _not_yaml(path: Path, error: yaml.YAMLError) -> InputError:
    mark = getattr(error, "problem_mark", None)
    where = f"{path}:{mark.line + 1}" if mark else str(path)
    problem = getattr(error, "problem", None) or "cannot be parsed"
    return InputError(where, f"is not valid YAML ({problem})", "correct the syntax")


def _invalid(path: Path, root: yaml.Node, error: ValidationError) -> InputError:
    """The most telling fault as one line, with the number of further ones."""
    # A misspelt key also shows as a missing one: name the misspelling.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    model, location = _resolve(first["loc"])
    where = _where(path, root, location)
    more = error.error_count() - 1
    rest = f" ({more} more in this file)" if more else ""
    if first["type"] == "extra_forbidden":
        allowed = [name for name in model.model_fields if name != "spec_version"]
        key = str(location[-1])
        return InputError(
            where, "unknown key", f"use {_guess(key, allowed)}one of {', '.join(allowed)}{rest}"
        )
    if first["type"] == "missing":
        return InputError(where, "is missing", f"add it{rest}")
    context = first.get("ctx", {})
    if first["type"] in ("union_tag_invalid", "union_tag_not_found"):
        tags = str(context.get("expected_tags") or ", ".join(_kinds(location))).replace("'", "")
        given = str(context.get("tag", ""))
        kind = _where(path, root, (*location, "kind"))
        problem = f"unknown kind {given!r}" if given else "is missing"
        return InputError(kind, problem, f"use {_guess(given, tags.split(', '))}one of {tags}{rest}")
    if first["type"] == "value_error":
        problem, _, remedy = str(context["error"]).rpartition(", ")
        return InputError(where, problem, remedy + rest)
    message = first["msg"][0].lower() + first["msg"][1:]
    return InputError(where, f"{first['input']!r} is not valid", message + rest)


def _resolve(loc: Location) -> tuple[type[BaseModel], Location]:
    """The model that holds the field of a pydantic location, and the location without union tags."""
    model: type[BaseModel] = Scenario
    plain: list[str | int] = []
    candidates: list[type[BaseModel]] = []
    for part in loc:
        tagged = [c for c in candidates if part in get_args(c.model_fields["kind"].annotation)]
        if tagged:
            model, candidates = tagged[0], []
            continue
        plain.append(part)
        if isinstance(part, str) and part in model.model_fields:
            models = list(_models_in(model.model_fields[part].annotation))
            candidates = [m for m in models if "kind" in m.model_fields]
            if models and not candidates:
                model = models[0]
    return model, tuple(plain)


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _kinds(location: Location) -> list[str]:
    field = Scenario.model_fields[str(location[0])].annotation
    return [str(kind) for m in _models_in(field) for kind in get_args(m.model_fields["kind"].annotation)]


def _guess(given: str, allowed: list[str]) -> str:
    close = get_close_matches(given, allowed, n=1, cutoff=0.5)
    return f"{close[0]} (did you mean that?), or " if close else ""


def _where(path: Path, root: yaml.Node, location: Location, node: yaml.Node | None = None) -> str:
    """``file:line: field.path``, the line being that of the innermost part that is in the file."""
    line = (node or _node_at(root, location)).start_mark.line + 1
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).lstrip(".")
    return f"{path}:{line}: {field}" if field else str(path)


def _node_at(root: yaml.Node, location: Location) -> yaml.Node:
    """The node of the location; for a key of a mapping the key itself."""
    at = value = root
    for part in location:
        if isinstance(value, yaml.MappingNode):
            found = next(((k, v) for k, v in value.value if k.value == part), None)
        elif isinstance(value, yaml.SequenceNode) and isinstance(part, int) and part < len(value.value):
            found = (value.value[part], value.value[part])
        else:
            found = None
        if found is None:
            break
        at, value = found
    return at


def _duplicate_keys(node: yaml.Node, location: Location = ()) -> Iterator[tuple[Location, yaml.Node]]:
    """Keys that YAML would silently let win over an earlier one of the same name."""
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            name = str(key.value)
            if name in seen:
                yield (*location, name), key
            seen.add(name)
            yield from _duplicate_keys(value, (*location, name))
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            yield from _duplicate_keys(value, (*location, index))
