"""What is read again of the summary of a run, and its types."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dslab.experiments.result_folder import SUMMARY_FILE
from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import problem_and_remedy
from dslab.scenarios.input_files import read_json
from dslab.scenarios.yaml_file import field_path

Count = Annotated[int, Field(ge=0)]
# No run has more metres, degrees or milliseconds, and sums of so many are still finite.
Amount = Annotated[float, Field(ge=0, le=1e12)]
# No field of a stress is larger either, and so many can be drawn.
_Dose = Annotated[float, Field(ge=-1e12, le=1e12)]
# Sums of parts may exceed the whole by rounding.
Share = Annotated[float, Field(ge=0, le=1 + 1e-9)]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")


class _Loss(_Part):
    declared_frame: Count | None
    delay_s: float | None
    true_loss_time_s: float | None
    silent: bool | None


class _Map(_Part):
    map_id: int
    corrupted: bool | None
    reason: str
    time_s: float | None
    error_m: Amount | None
    rotation_deg: Amount | None
    path_m: Amount | None


class _Live(_Part):
    judged: Count
    poses: Count
    reason: str


class _Declared(_Part):
    false: bool | None
    time_s: float


class _Audit(_Part):
    losses: list[_Loss]
    maps: list[_Map]
    live: _Live
    loops: list[_Declared]
    fusions: list[_Declared]
    joins: list[_Declared]
    relocalizations: list[_Declared]


class _Stage(_Part):
    frames: Count
    cpu_ms_median: Amount | None


class _Breakage(_Part):
    frame: Count
    segment: str | None
    recovered: bool
    healthy: bool | None
    false_fusion: bool | None
    to_fusion_s: float | None
    view_overlap: Share | None = None


class _Segment(_Part):
    kind: str
    start_s: float
    end_s: float
    severity: dict[str, _Dose | str | bool | list[Any] | None]


class _Summary(_Part):
    sequence: str
    system: str
    frames: Annotated[int, Field(ge=1)]
    declares: str
    breakages: Count | None
    completeness: Share | None = None
    path_share: Share | None
    intact: bool | None = None
    ate_m: Amount | None
    rpe_m: Amount | None = None
    cpu_ms_median: Amount | None
    stages: dict[str, _Stage]
    segments: list[_Segment]
    source: str = ""
    scenario_seed: int | None = None
    input: dict[str, str] | None = None
    config: dict[str, Any]
    code: str = ""
    audit: _Audit | None
    breakage_list: list[_Breakage]


def read_summary(folder: Path) -> dict[str, Any]:
    """Read the summary of a result folder.

    Raises:
        InputError: it is no summary of a run: a figure is missing, of another type or out of its range.
    """
    path = folder / SUMMARY_FILE
    summary = read_json(path, dict)
    try:
        _Summary.model_validate(summary)
    except ValidationError as error:
        fault = error.errors()[0]
        problem, why = problem_and_remedy(fault)
        said = "" if fault["type"] == "missing" else f" ({why})"
        remedy = "run it again, or leave it out"
        raise InputError(f"{path}: {field_path(fault['loc'])}", f"{problem[:80]}{said}", remedy) from None
    return summary
