"""Validation errors of scenarios as one line: place, problem and remedy."""

from collections.abc import Callable
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from dslab.scenarios.errors import InputError, SeveralFaultsError
from dslab.scenarios.kinds import models_in
from dslab.scenarios.spec import Scenario
from dslab.scenarios.yaml_file import Location

OWN_KIND = "; one of your own comes with DSLAB_PLUGINS=file.py"
"""End of the remedy where a kind is not known: it may be registered in a file that was not named."""


def guess(given: str, allowed: list[str]) -> str:
    """Suggest an allowed word as the start of a remedy; empty if none is similar."""
    close = get_close_matches(given, allowed, n=1, cutoff=0.5)
    return f"{close[0]} (did you mean that?), or " if close else ""


def problem_and_remedy(fault: Any) -> tuple[str, str]:
    """Problem and remedy of one of pydantic's errors."""
    if fault["type"] == "missing":
        return "is missing", "add it"
    if fault["type"] == "value_error":
        problem, _, remedy = str(fault["ctx"]["error"]).rpartition(", ")
        return problem, remedy
    return f"{fault['input']!r} is not valid", fault["msg"][0].lower() + fault["msg"][1:]


def all_faults(
    error: ValidationError,
    where: Callable[[Location], str],
    of_sample: str = "",
    extra_keys: tuple[str, ...] = (),
    root: type[BaseModel] = Scenario,
) -> InputError:
    """The faults of a spec as one error, the most informative first.

    Args:
        error: from validating ``root``, usually a scenario.
        where: file, line and field of a location in it.
        of_sample: description of family and seed; empty if nothing was drawn.
        extra_keys: keys that are allowed at the top beside the model's own.
        root: the model.
    """
    # A misspelt key also shows as a missing one: name the misspelling.
    ordered = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    explained = (_explained(fault, extra_keys, root) for fault in ordered)
    faults = [InputError(where(at), problem + of_sample, remedy) for at, problem, remedy in explained]
    return faults[0] if len(faults) == 1 else SeveralFaultsError(faults)


def field_annotation(location: Location, data: Any) -> Any:
    """Type of the field at a location of a scenario's data; None if unknown.

    Args:
        location: of the field.
        data: the scenario as plain data, whose kinds select the models.
    """
    found: Any = Scenario
    for part in location:
        if not isinstance(part, int):
            model = _model_of(data, found)
            found = model.model_fields.get(part) if model else None
            if found is None:
                return None
        data = data[part]
    return found.annotation if isinstance(found, FieldInfo) else found


def _explained(fault: Any, extra_keys: tuple[str, ...], root: type[BaseModel]) -> tuple[Location, str, str]:
    """Location, problem and remedy of one of pydantic's errors."""
    model, location = _resolve(fault["loc"], root)
    context = fault.get("ctx", {})
    if fault["type"] == "extra_forbidden":
        allowed = [*model.model_fields, *(extra_keys if model is root else ())]
        return location, "unknown key", f"use {guess(str(location[-1]), allowed)}one of {', '.join(allowed)}"
    if fault["type"] in ("union_tag_invalid", "union_tag_not_found"):
        tags = str(context.get("expected_tags") or ", ".join(_kinds(location, root))).replace("'", "")
        given = str(context.get("tag", ""))
        problem = f"unknown kind {given!r}" if given else "is missing"
        own = OWN_KIND if given else ""
        return (*location, "kind"), problem, f"use {guess(given, tags.split(', '))}one of {tags}{own}"
    return location, *problem_and_remedy(fault)


def _resolve(loc: Location, root: type[BaseModel]) -> tuple[type[BaseModel], Location]:
    """Model of the field at a pydantic location, and the location without union tags."""
    model = root
    plain: list[str | int] = []
    candidates: list[type[BaseModel]] = []
    for part in loc:
        tagged = [c for c in candidates if part in get_args(c.model_fields["kind"].annotation)]
        if tagged:
            model, candidates = tagged[0], []
            continue
        plain.append(part)
        if isinstance(part, str) and part in model.model_fields:
            models = list(models_in(model.model_fields[part]))
            candidates = models if len(models) > 1 else []
            model = models[0] if len(models) == 1 else model
    return model, tuple(plain)


def _model_of(data: Any, annotation: Any) -> type[BaseModel] | None:
    """The model of a mapping, by its kind if there are several."""
    models = list(models_in(annotation))
    if not isinstance(data, dict) or not models:
        return None
    if len(models) == 1:
        return models[0]
    kind = data.get("kind")
    return next((m for m in models if kind in get_args(m.model_fields["kind"].annotation)), None)


def _kinds(location: Location, root: type[BaseModel]) -> list[str]:
    field = root.model_fields[str(location[0])]
    return [str(kind) for m in models_in(field) for kind in get_args(m.model_fields["kind"].annotation)]
