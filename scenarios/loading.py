"""Scenarios by name or from YAML files; every fault of a file is one clear line."""

import json
from pathlib import Path

import yaml

from dslab.scenarios.families import load_family
from dslab.scenarios.spec import Scenario


def load_scenario(path_or_name: str | Path, seed: int | None = None) -> Scenario:
    """The scenario that a family gives with a seed.

    Args:
        path_or_name: one of ``family_names()``, a bare family name, of whose members the seed takes one, or
            the path of a YAML file.
        seed: what distributions are drawn with; becomes the scenario's own. None for the family's own.

    Raises:
        InputError: no such name or file, no YAML, or content that is no valid scenario.
    """
    family = load_family(path_or_name)
    return family.sample(family.seed if seed is None else seed)


def dump_yaml(scenario: Scenario) -> str:
    """The scenario with every default written out, as YAML that ``load_scenario`` reads back."""
    return yaml.safe_dump(json.loads(scenario.model_dump_json()), sort_keys=False, allow_unicode=True)
