"""Specs of the first version, whose cells could mix populations: read for the tables beside them."""

import math
from pathlib import Path
from typing import Any

from dslab.experiments.eq1.spec import ExperimentSpec, load_spec, read_spec_file, validated

_UNITS_PER_WORLD = "units_per_world"


def load_any_spec(path: Path) -> ExperimentSpec:
    """Load a spec from a YAML file, of any version.

    Of the first the cells and their numbers of units are as they were; that a cell mixes populations is no
    fault, and its units cannot be drawn again.

    Raises:
        InputError: the file does not exist, or is no valid YAML or experiment.
    """
    file = read_spec_file(path)
    if not is_former(file.data):
        return load_spec(path)
    return validated(as_current(file.data), file)


def is_former(data: Any) -> bool:
    """True if the data of a spec are of the first version."""
    return isinstance(data, dict) and ("units" in data or data.get("spec_version") == 1)


def as_current(data: dict[str, Any]) -> dict[str, Any]:
    """The data of a spec of the first version with the fields of the second."""
    kept = {k: v for k, v in data.items() if k not in ("units", _UNITS_PER_WORLD, "stopping")}
    per_world = data.get(_UNITS_PER_WORLD, 1)
    design = {"worlds": math.ceil(data["units"] / per_world), "sequences_per_world": per_world, "sham": False}
    return {**kept, **design, "spec_version": 2}
