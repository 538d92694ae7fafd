"""The JSON Schema of scenario files."""

import copy

import jsonschema
import yaml
from test_families import FAMILY, MEMBERS

from dslab.scenarios.families import library_names, load_family
from dslab.scenarios.schema import json_schema
from dslab.scenarios.spec import Scenario


def test_the_schema_knows_every_part_and_forbids_unknown_keys():
    schema = json_schema()
    assert set(schema["properties"]) == {*Scenario.model_fields, "members"}
    assert schema["additionalProperties"] is False
    plain, _ = schema["$defs"]["LowTexture"]["properties"]["contrast"]["anyOf"]
    assert (plain["minimum"], plain["maximum"]) == (0, 1)
    assert set(schema["properties"]["members"]["additionalProperties"]["properties"]) == {
        *Scenario.model_fields
    } - {"name"}


def test_every_node_may_be_a_distribution():
    schema = json_schema()
    models = [schema, *(model for model in schema["$defs"].values() if "properties" in model)]
    assert len(models) > 20
    for model in models:
        for name, field in model["properties"].items():
            if name in ("name", "description", "seed", "members"):
                continue
            drawn = field["anyOf"][1]
            assert "choice" in str(drawn)
            number = field["anyOf"][0].get("type") in ("number", "integer")
            assert ("log_uniform" in str(drawn)) == number or name == "segments"
    segments = schema["properties"]["segments"]["anyOf"][0]
    assert "choice" in segments["items"]["anyOf"][1]["properties"]


def test_a_validator_agrees():
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    files = [load_family(name).file.data for name in library_names()]
    files += [yaml.safe_load(text) for text in (FAMILY, MEMBERS)]
    files += [load_family(name).sample(1).model_dump(mode="json") for name in library_names()]
    for data in files:
        assert not list(validator.iter_errors(data)), data["name"]
    faults = [
        {"duration_s": {"uniform": [1]}},
        {"duration_s": {"choice": []}},
        {"duration_s": {"uniform": [1, 2], "weights": [1, 1]}},
        {"name": {"choice": ["a", "b"]}},
        {"world": {"kind": "room", "lenght_m": 8}},
        {"members": {"A b": {}}},
        {"members": {"a": {"name": "b"}}},
        {"segments": {"uniform": [1, 2]}},
    ]
    for fault in faults:
        assert not validator.is_valid({**copy.deepcopy(files[-1]), **fault}), fault
    assert not validator.is_valid({"name": "no-world"})
