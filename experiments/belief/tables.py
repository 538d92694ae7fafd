"""Fitted beliefs as a file: the model's parameters, and what they were fitted to."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import write_file
from dslab.slam.belief.model import Parameters


class Fitted(BaseModel):
    """What ``dslab belief fit`` has found.

    Attributes:
        parameters: of the model.
        fitted_to: folders, numbers of hypotheses, commit.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    parameters: Parameters
    fitted_to: dict[str, Any]


def write_fitted(path: Path, parameters: Parameters, fitted_to: dict) -> None:
    """Write the file."""
    text = {"parameters": asdict(parameters), "fitted_to": fitted_to}
    write_file(path, lambda place: place.write_text(json.dumps(text, indent=2) + "\n"))


def read_fitted(path: Path) -> Fitted:
    """Read the file.

    Raises:
        InputError: it cannot be read, or is not one.
    """
    try:
        return TypeAdapter(Fitted).validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(
            str(path), f"cannot be read: {error.strerror}", "name a file of `dslab belief fit`"
        ) from None
    except ValidationError as error:
        fault = error.errors()[0]
        field = ".".join(map(str, fault["loc"])) or "the file"
        problem = f"{field}: {fault['msg'][:1].lower()}{fault['msg'][1:]}"
        raise InputError(str(path), problem, "write it anew with `dslab belief fit`") from None
