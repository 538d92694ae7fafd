"""A batch: sequences times systems times runs, as a YAML file says."""

import glob
import re
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from dslab.experiments.batch.doses import DoseSeries, dose_series
from dslab.experiments.runs.execution import Mode, SystemFactory
from dslab.experiments.runs.slam_settings import factory_of, parse_slam_settings
from dslab.experiments.runs.sources import is_recorded
from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import all_faults
from dslab.scenarios.input_files import is_folder, is_text
from dslab.scenarios.segment_text import parse_segment
from dslab.scenarios.segments import SegmentBase
from dslab.scenarios.strict import Strict
from dslab.scenarios.yaml_file import YamlFile, read_yaml
from dslab.sim.cache import content_key

_PATTERN = re.compile(r"[*?\[]")
_MOST_SEED = 2**63 - 1
_OF_A_ROW = ("vary", "skip_frames", "first_s", "stress", "seed", "mode", "real_time", "settings")


class BatchSpec(Strict):
    """What is run: every system over every sequence, several times."""

    sequences: tuple[str, ...] = Field(min_length=1, description="folders, bags, patterns of them, scenarios")
    systems: tuple[str, ...] = Field(
        min_length=1, description="names of `dslab systems list`, or module:Class"
    )
    runs: int = Field(10, ge=1, le=10_000, description="runs of each system over each sequence")
    vary: Literal["seeds", "scenes", "start", "nothing"] = Field(
        "seeds",
        description="what differs from run to run: the system's seed, that of scenarios too, the first "
        "frame, or nothing",
    )
    skip_frames: int = Field(
        1, ge=1, description="frames that each further run leaves out, if the start varies"
    )
    first_s: float | None = Field(None, gt=0, description="seconds of each sequence; all of it if left out")
    stress: tuple[str, ...] = Field(
        (), description="segments, as those of `dslab degrade`; a list as one value is a series of doses"
    )
    seed: int = Field(0, ge=0, le=_MOST_SEED, description="root of all seeds")
    mode: Mode = Field("lockstep", description="schedule of our systems")
    real_time: bool = Field(
        False, description="feed ours and classes in real time, which needs mode threaded"
    )
    settings: dict[str, Any] = Field(
        default_factory=dict, description="of our systems, as in a settings file of `dslab run`"
    )
    hypotheses: bool = Field(
        False,
        description="log what our systems suppose of places, and the truth: hypotheses.parquet",
    )
    limit_s: float = Field(7200.0, gt=0, description="longest duration of a run, its preparation included")

    @field_validator("systems")
    @classmethod
    def _all_different(cls, systems: tuple[str, ...]) -> tuple[str, ...]:
        double = next((name for name in systems if systems.count(name) > 1), None)
        if double is not None:
            raise ValueError(f"{double} is named twice, name each once")
        return systems

    @model_validator(mode="after")
    def _all_have_seeds(self) -> Self:
        if self.vary in ("seeds", "scenes") and self.seed + self.runs - 1 > _MOST_SEED:
            raise ValueError(f"its last run has a seed beyond {_MOST_SEED}, give a smaller seed")
        return self

    @property
    def series(self) -> DoseSeries | None:
        """The doses of the stress; None for one stress, or none."""
        return dose_series(self.stress)

    @property
    def stresses(self) -> dict[float | None, tuple[str, ...]]:
        """The stress at each dose; at None if it has no series."""
        return {**self.series.stresses} if self.series else {None: self.stress}

    def segments(self, dose: float | None) -> list[SegmentBase]:
        """The segments of the stress at a dose."""
        return [parse_segment(text) for text in self.stresses[dose]]

    @property
    def build(self) -> SystemFactory:
        """Makes our systems, with the settings and the mode."""
        settings = parse_slam_settings(self.settings, (), lambda at: ".".join(map(str, at)))
        return factory_of(settings, self.mode)

    @property
    def row_key(self) -> str:
        """Hash of all that makes a row beside its sequence, dose, system and run."""
        pattern = self.series.pattern if self.series else self.stress
        logged = {"hypotheses": True} if self.hypotheses else {}
        made = self.model_dump(mode="json", include=set(_OF_A_ROW)) | {"stress": pattern} | logged
        return content_key(made)


def read_batch(path: Path) -> tuple[BatchSpec, list[str]]:
    """Read and check a batch; its folders and scenarios, patterns written out.

    Raises:
        InputError: the file cannot be read or is not valid, a pattern fits no sequence, or a segment is none.
    """
    file = read_yaml(path, "batch", "the documentation, batches")
    try:
        spec = BatchSpec.model_validate(file.data)
    except ValidationError as error:
        raise all_faults(error, file.where, root=BatchSpec) from None
    if spec.real_time and spec.mode != "threaded":
        raise InputError(file.where(("real_time",)), f"the mode is {spec.mode}", "add mode: threaded")
    if "mode" in spec.settings:
        raise InputError(file.where(("settings", "mode")), "the batch has a mode of its own", "give it there")
    parse_slam_settings(spec.settings, ("settings",), file.where)
    for place, text in enumerate(spec.stress):
        try:
            single = dose_series([text])
            for stress in single.stresses.values() if single else [(text,)]:
                parse_segment(*stress)
        except InputError as fault:
            raise InputError(file.where(("stress", place)), fault.problem, fault.remedy) from None
    try:
        dose_series(spec.stress)
    except InputError as fault:
        raise InputError(file.where(("stress",)), f"{fault.where} {fault.problem}", fault.remedy) from None
    return spec, _sources(file, spec)


def _sources(file: YamlFile, spec: BatchSpec) -> list[str]:
    found: list[str] = []
    for place, text in enumerate(spec.sequences):
        where = file.where(("sequences", place))
        # The folder of this very name comes first: one may be called [x].
        is_pattern = _PATTERN.search(text) and not is_folder(text)
        found += _matches(where, text) if is_pattern else [_checked(where, text)]
    double = next((source for source in found if found.count(source) > 1), None)
    if double is not None:
        raise InputError(file.where(("sequences",)), f"{double} is named twice", "name each once")
    return found


def _matches(where: str, pattern: str) -> list[str]:
    """The sequence folders and bags that a pattern fits."""
    from dslab.sim.io.forms import detect_form

    found = []
    for name in sorted(filter(is_recorded, glob.glob(pattern))):
        try:
            if is_folder(name):
                detect_form(Path(name))
        except InputError:
            continue
        if not is_text(name):
            raise InputError(where, f"the name of {name!r} is not UTF-8", "rename that folder")
        found.append(name)
    if not found:
        raise InputError(where, f"{pattern!r} fits no sequence", "correct the pattern")
    return found


def _checked(where: str, source: str) -> str:
    """A source that can be opened, as far as that is known without its frames."""
    from dslab.scenarios.loading import load_scenario
    from dslab.sim.io.forms import load_sequence

    try:
        load_sequence(source) if is_recorded(source) else load_scenario(source, None)
    except InputError as fault:
        raise InputError(f"{where} ({fault.where})", fault.problem, fault.remedy) from None
    return source
