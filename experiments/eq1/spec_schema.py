"""The JSON Schema of experiment files, for editors and for programs that write them."""

from typing import Any

from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.unit_drawing import PARTS
from dslab.scenarios import schema as scenario_schema
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS


def json_schema() -> dict[str, Any]:
    """The JSON Schema of an experiment file, with distributions wherever they are allowed."""
    schema = ExperimentSpec.model_json_schema()
    scenario = scenario_schema.json_schema()
    schema["$defs"] = {**scenario["$defs"], **schema["$defs"]}
    base = schema["$defs"]["Base"]["properties"]
    base.update({part: scenario["properties"][part] for part in PARTS})
    # A base with a family need not give the kind of world.
    kindless = {"not": {"anyOf": [{"required": ["kind"]}, {"required": ["choice"]}]}}
    base["world"] = {"anyOf": [base["world"], {"type": "object", **kindless}]}
    degradation = schema["$defs"]["Degradation"]["properties"]
    number = {"anyOf": [{"type": "number", "minimum": 0}, {"$ref": "#/$defs/Distribution"}]}
    for name in ("begins_s", "acts_s"):
        degradation[name] = {"description": degradation[name]["description"], **number}
    degradation["kind"] = {**degradation["kind"], "enum": sorted(SEGMENT_KINDS)}
    # A thread may be given by the name of its kind alone.
    thread = {"anyOf": [{"enum": sorted(RECOVERY_KINDS)}, {"$ref": "#/$defs/ThreadChoice"}]}
    schema["properties"]["threads"]["items"] = thread
    return {"$schema": scenario["$schema"], **schema}
