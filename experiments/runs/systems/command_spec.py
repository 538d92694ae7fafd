"""Programs as systems: the YAML file that describes one."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import all_faults, guess
from dslab.scenarios.strict import Strict
from dslab.scenarios.yaml_file import read_yaml

OWN_FOLDER = Path(__file__).parent
"""Folder of the descriptions that come with the lab."""
PLACEHOLDERS = ("sequence", "out", "settings", "seed", "vocabulary", "python", "here")
_PLACEHOLDER = re.compile(r"\{(\w+)\}")
_FILE_NAME = re.compile(r"[\w.*-]+(/[\w.*-]+)*")
_LIKE = "like"
_MOST_LIKE = 8


class Limits(Strict):
    """What a program may take; beyond it, it is ended."""

    start_s: float = Field(120.0, gt=0, description="seconds for its start and end")
    slow_down: float = Field(20.0, gt=0, description="seconds of run per second of sequence, beside start_s")
    memory_mb: int = Field(8000, ge=1, description="resident memory of all its processes, MiB")


class Environment(Strict):
    """An environment of Python of the program's own."""

    packages: tuple[str, ...] = Field((), description="what pip installs there")
    commit: str | None = Field(
        None,
        pattern=r"^[0-9a-f]{7,40}$",
        description="of this lab, installed in their place, with the versions that it locks",
    )
    imports: tuple[str, ...] = Field((), description="modules that can then be imported")
    note: str = Field("", description="what else it needs, said where it cannot be imported")

    @model_validator(mode="after")
    def _holds_something(self) -> "Environment":
        if bool(self.packages) == bool(self.commit):
            raise ValueError("holds both or neither, give packages or a commit of this lab")
        return self

    @property
    def contents(self) -> tuple[str, ...]:
        """What is installed there, in words that change with it."""
        return self.packages or (f"this lab at {(self.commit or '')[:12]}",)


class CommandSpec(Strict):
    """Description of a program: how it is called, what it reads and leaves.

    Files are relative to the folder ``{out}``. All but the trajectory may be absent. A ``*`` in the name of
    a trajectory or of keyframes stands for the number of a map, each of which has its own file.
    """

    about: str = Field("", description="one line")
    command: str = Field(min_length=1, description="command line with placeholders")
    reads: Literal["tum", "kitti", "euroc", "vslam-lab"] = Field(
        "tum", description="form of the folder {sequence}"
    )
    trajectory: str = Field("trajectory.txt", description="file of the final poses, camera to map")
    trajectory_form: Literal["tum", "kitti", "euroc"] = Field("tum", description="form of its files of poses")
    live: str | None = Field(None, description="file of the poses as they were given, frame by frame")
    keyframes: str | None = Field(None, description="file of the keyframes' final poses")
    frames: str | None = Field(
        None,
        description="CSV of stamp_s and any of state, ms, cpu_ms, map_id, mapping_cpu_ms, loop_cpu_ms",
    )
    events: str | None = Field(None, description="its events, as in the lab's own events.jsonl")
    lost_states: tuple[str, ...] = Field((), description="words in state by which it declares a loss")
    pace: Literal["free", "real_time"] = Field("free", description="how it takes the frames")
    limits: Limits = Limits()
    environment: Environment | None = Field(None, description="made by `dslab systems install`")
    systems: tuple[str, ...] = Field(
        (),
        description="of a file lab@0.2.0.yaml, run as base@0.2.0 and so on: values of the setting `system`",
    )
    settings: dict[str, str | float | int | bool | None] = Field({}, description="in the JSON {settings}")

    @field_validator("command")
    @classmethod
    def _placeholders_exist(cls, command: str) -> str:
        unknown = [name for name in _PLACEHOLDER.findall(command) if name not in PLACEHOLDERS]
        if unknown:
            near = guess(unknown[0], list(PLACEHOLDERS)) + "one of"
            known = " ".join(f"{{{name}}}" for name in PLACEHOLDERS)
            raise ValueError(f"unknown placeholder {{{unknown[0]}}}, use {near} {known}")
        for name in ("sequence", "out"):
            if name not in _PLACEHOLDER.findall(command):
                raise ValueError(f"does not say where {{{name}}} goes, add {{{name}}}")
        return command

    @field_validator("trajectory", "live", "keyframes", "frames", "events")
    @classmethod
    def _inside(cls, name: str | None, info: ValidationInfo) -> str | None:
        if name is not None and (not _FILE_NAME.fullmatch(name) or ".." in name.split("/")):
            raise ValueError(f"{name!r} is no file below {{out}}, give a relative path")
        if name is not None and name.count("*") > (info.field_name in ("trajectory", "keyframes")):
            raise ValueError(f"{name!r} has a * too many, put one into trajectory and keyframes alone")
        return name


def read_command_spec(path: Path, folders: tuple[Path, ...] = (OWN_FOLDER,)) -> CommandSpec:
    """Read and check the description of a program.

    Args:
        path: of the YAML file. Its key ``like`` names another description, over which this one is laid.
        folders: where that other one may be.

    Raises:
        InputError: the file cannot be read, or is not valid, with its line.
    """
    file = read_yaml(path, "system", "the documentation, bring your own SLAM")
    try:
        return CommandSpec.model_validate(_laid_over(path, file.data, folders, _MOST_LIKE))
    except ValidationError as error:
        raise all_faults(error, file.where, extra_keys=(_LIKE,), root=CommandSpec) from None


def _laid_over(path: Path, data: Mapping[Any, Any], folders: tuple[Path, ...], depth: int) -> dict[Any, Any]:
    """The data of a description with what it does not say taken from the one that it is like."""
    own = {key: value for key, value in data.items() if key != _LIKE}
    if _LIKE not in data:
        return own
    name = str(data[_LIKE])
    found = [folder / f"{name}.yaml" for folder in folders if (folder / f"{name}.yaml").is_file()]
    if not found or depth == 0 or found[0].resolve() == path.resolve():
        raise InputError(f"{path}: {_LIKE}", f"there is no other system {name!r}", "see `dslab systems list`")
    other = read_yaml(found[0], "system", "the documentation, bring your own SLAM")
    base = _laid_over(found[0], other.data, folders, depth - 1)
    # {here} in the command of the other is its folder.
    if isinstance(base.get("command"), str):
        base["command"] = base["command"].replace("{here}", str(found[0].parent))
    return _merged(base, own)


def _merged(base: Mapping[Any, Any], over: Mapping[Any, Any]) -> dict[Any, Any]:
    both = {
        key: _merged(base[key], value)
        for key, value in over.items()
        if isinstance(value, dict) and isinstance(base.get(key), dict)
    }
    return {**base, **over, **both}


def filled(command_words: list[str], values: Mapping[str, Any]) -> list[str]:
    """The words of a command with their placeholders filled in."""
    return [_PLACEHOLDER.sub(lambda m: str(values.get(m[1], m[0])), word) for word in command_words]
