"""Settings of a system from and as YAML: every field described, unknown keys refused.

What a setting means, its unit and its bounds are said where it is declared (:mod:`slam.core.settings`).
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import yaml
from pydantic import Field, TypeAdapter, ValidationError

from dslab.experiments.runs.execution import Mode, SlamSystem
from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import guess, problem_and_remedy
from dslab.scenarios.yaml_file import Location, read_yaml
from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.settings import MOST
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS, ThreadSpec
from dslab.slam.factory import build_system, default_settings
from dslab.slam.framework.dual_of import FrameworkConfig
from dslab.slam.ldso.config import DsoConfig
from dslab.slam.runtime.backend import ExecutionMode

_SUMMARY_KEY = "config"
_DUAL, _DSO, _FRAMEWORK, _MODE = "dual", "dso", "framework", "mode"
_SECTIONS = (_DUAL, _DSO, _FRAMEWORK, _MODE)
_UNITS = {"_s": "s", "_ms": "ms", "_px": "px", "_deg": "deg"}
_Seed = Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class SlamSettings:
    """Settings that a file or options give, over those that a system has by itself.

    Attributes:
        written: fields of :class:`SlamConfig` as written.
        written_dual: fields of :class:`DualConfig` as written.
        written_dso: fields of :class:`DsoConfig` as written.
        written_framework: fields of :class:`FrameworkConfig` as written.
        dual_options: fields of :class:`DualConfig` that go before what is written.
        mode: how tracking and mapping share time; None where nothing is said of it.
    """

    written: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    written_dual: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    written_dso: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    written_framework: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    dual_options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    mode: Mode | None = None

    def of(self, kind: str, camera: PinholeCamera) -> tuple[SlamConfig, DualConfig]:
        """The settings of a system for a camera: of the base, and of Dual-SLAM."""
        config, dual = default_settings(kind, camera)
        config = _overlaid(config, self.written, (), _unlocated)
        dual = _overlaid(dual, self.written_dual, (_DUAL,), _unlocated, base=config)
        return config, replace(dual, **self.dual_options)

    @property
    def dso(self) -> DsoConfig:
        """The settings of direct sparse odometry."""
        return _overlaid(DsoConfig(), self.written_dso, (_DSO,), _unlocated)

    @property
    def framework(self) -> FrameworkConfig:
        """The settings of Dual-SLAM over any system."""
        return _overlaid(FrameworkConfig(), self.written_framework, (_FRAMEWORK,), _unlocated)


def read_slam_settings(path: Path) -> SlamSettings:
    """Read settings from a YAML file, or from a run's ``summary.json``.

    Raises:
        InputError: no such file, an unknown key, or a value of the wrong type or range, with its line.
    """
    file = read_yaml(path, "settings", "`dslab config show`")
    data, at = file.data, ()
    if _SUMMARY_KEY in data and _SUMMARY_KEY not in {f.name for f in fields(SlamConfig)}:
        data, at = data[_SUMMARY_KEY], (_SUMMARY_KEY,)
    return parse_slam_settings(data, at, file.where)


def parse_slam_settings(data: Any, at: Location, locate: Callable[[Location], str]) -> SlamSettings:
    """Check settings as written.

    Args:
        data: mapping of fields, nested as in a settings file.
        at: its location.
        locate: names the place of a location, for faults.

    Raises:
        InputError: an unknown key, or a value of the wrong type or range.
    """
    if not isinstance(data, Mapping):
        raise InputError(locate(at), "is no mapping", "start from `dslab config show`")
    own = {key: value for key, value in data.items() if key not in _SECTIONS}
    base = _overlaid(SlamConfig(), own, at, locate, extra=_SECTIONS)
    dual = data.get(_DUAL) or {}
    _overlaid(DualConfig(), dual, (*at, _DUAL), locate, base=base)
    dso = data.get(_DSO) or {}
    _overlaid(DsoConfig(), dso, (*at, _DSO), locate)
    framework = data.get(_FRAMEWORK) or {}
    _overlaid(FrameworkConfig(), framework, (*at, _FRAMEWORK), locate)
    mode: Mode | None = None
    if _MODE in data:
        mode = _checked(data[_MODE], Mode, (*at, _MODE), locate)
    return SlamSettings(own, dual, dso, framework, mode=mode)


@dataclass(frozen=True)
class SettingsFactory:
    """A factory of systems with settings.

    Attributes:
        settings: of them.
        mode: how tracking and mapping share time.
    """

    settings: SlamSettings
    mode: ExecutionMode

    def __call__(self, kind: str, camera: PinholeCamera, seed: int) -> SlamSystem:
        """Make a system."""
        config, dual = self.settings.of(kind, camera)
        return build_system(kind, camera, seed, config, self.mode, dual, self.settings.dso)


def factory_of(settings: SlamSettings, mode: Mode = "lockstep") -> SettingsFactory:
    """A factory of systems with these settings."""
    return SettingsFactory(settings, ExecutionMode(settings.mode or mode))


def settings_yaml() -> str:
    """All settings with their defaults as YAML, each with meaning, unit and range above it."""
    lines = ["# Numbers are 0 or more where nothing else is said.", ""]
    lines += ["# Settings of the base; orb.n_features is 2000 for images wider than 640x480."]
    lines += _described(SlamConfig(), 0)
    lines += ["", "# Settings of Dual-SLAM.", f"{_DUAL}:", *_described(DualConfig(), 1)]
    lines += ["", "# Settings of direct sparse odometry.", f"{_DSO}:", *_described(DsoConfig(), 1)]
    lines += ["", "# Settings of Dual-SLAM over any system."]
    lines += [f"{_FRAMEWORK}:", *_described(FrameworkConfig(), 1)]
    return "\n".join(lines) + "\n"


def fields_of(settings: type) -> dict[str, dict[str, Any]]:
    """JSON Schema of each field of a class of settings: meaning, bounds, ``unit`` where there is one."""
    described = TypeAdapter(settings).json_schema()["properties"]
    for name, node in described.items():
        unit = next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)
        if unit is not None:
            node["unit"] = unit
    return described


def unit_and_range(field: Mapping[str, Any]) -> str:
    """A field's unit and its bounds, as far as they are not those of all: ``px, more than 0``."""
    above, least, most = (field.get(key) for key in ("exclusiveMinimum", "minimum", "maximum"))
    words = [field.get("unit", "")]
    if above is None and most is not None and most < MOST:
        words.append(f"{least:g} to {most:g}")
    else:
        words.append(f"more than {above:g}" if above is not None else f"{least:g} or more" if least else "")
        words.append(f"at most {most:g}" if most is not None and most < MOST else "")
    words.append(f"below {field['exclusiveMaximum']:g}" if "exclusiveMaximum" in field else "")
    return ", ".join(filter(None, words))


def _unlocated(at: Location) -> str:
    return ".".join(map(str, at))


def _overlaid(
    default: Any,
    written: Any,
    at: Location,
    locate: Any,
    extra: tuple[str, ...] = (),
    base: SlamConfig | None = None,
) -> Any:
    """A settings object with what is written in the place of its defaults.

    Where the default is None for the system's own, what is written is laid over the field of that name in
    ``base``.
    """
    if not isinstance(written, Mapping):
        raise InputError(locate(at), f"{written!r} is no mapping", "give fields with their values")
    hints = get_type_hints(type(default))
    known = [f.name for f in fields(default)]
    changes = {}
    for key, value in written.items():
        if key not in known:
            allowed = [*known, *extra]
            remedy = f"use {guess(str(key), allowed)}one of {', '.join(allowed)}"
            raise InputError(locate((*at, str(key))), "unknown key", remedy)
        own = getattr(default, key)
        if own is None and base is not None:
            own = getattr(base, key, None)
        changes[key] = _value(own, value, hints[key], (*at, key), locate, base)
    with _faults_at(at, locate):
        return replace(default, **changes)


def _value(default: Any, written: Any, hint: Any, at: Location, locate: Any, base: SlamConfig | None) -> Any:
    if hint == tuple[ThreadSpec, ...]:
        if not isinstance(written, list):
            raise InputError(locate(at), f"{written!r} is no list", "give kinds, such as [orb, sift]")
        return tuple(_thread(item, (*at, i), locate, base) for i, item in enumerate(written))
    nested = _nested(hint)
    if nested is not None and not (written is None and NoneType in _options(hint)):
        return _overlaid(default if is_dataclass(default) else nested(), written, at, locate, base=base)
    if written is None and hint is float:
        return math.inf  # JSON has no infinity: a summary says null
    return tuple(written) if isinstance(written, list) else written


def _thread(written: Any, at: Location, locate: Any, base: SlamConfig | None) -> ThreadSpec:
    """A recovery thread: its kind, or a mapping of kind, seed and config."""
    data = {"kind": written} if isinstance(written, str) else written
    if not isinstance(data, Mapping) or "kind" not in data:
        raise InputError(locate(at), f"{written!r} names no kind", "give a kind, or kind, seed and config")
    unknown = [key for key in data if key not in ("kind", "seed", "config")]
    if unknown:
        raise InputError(locate((*at, str(unknown[0]))), "unknown key", "use kind, seed or config")
    kind, kinds = str(data["kind"]), list(RECOVERY_KINDS)
    if kind not in kinds:
        remedy = f"use {guess(kind, kinds)}one of {', '.join(kinds)}"
        raise InputError(locate((*at, "kind")), f"unknown recovery thread {kind!r}", remedy)
    seed = _checked(data.get("seed", 0), _Seed, (*at, "seed"), locate)
    config = data.get("config")
    if config is not None:
        config = _overlaid(_thread_defaults(kind), config, (*at, "config"), locate, base=base)
    return ThreadSpec(kind, seed, config)


def _thread_defaults(kind: str) -> RecoveryConfig:
    return getattr(RECOVERY_KINDS[kind](None), "config", None) or RecoveryConfig()


def _checked(written: Any, hint: Any, at: Location, locate: Any) -> Any:
    with _faults_at(at, locate):
        return TypeAdapter(hint).validate_python(written, strict=True)


@contextmanager
def _faults_at(at: Location, locate: Callable[[Location], str]) -> Iterator[None]:
    """Turn the first of pydantic's errors into one of the file's."""
    try:
        yield
    except ValidationError as error:
        fault = error.errors()[0]
        raise InputError(locate((*at, *fault["loc"])), *problem_and_remedy(fault)) from None


def _options(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _nested(hint: Any) -> Any:
    """The class of settings that a field holds, None for a plain value."""
    return next((t for t in _options(hint) if is_dataclass(t)), None)


def _described(settings: Any, depth: int) -> Iterator[str]:
    indent = "  " * depth
    for name, field in fields_of(type(settings)).items():
        value, span = getattr(settings, name), unit_and_range(field)
        yield f"{indent}# {field['description']}{f' [{span}]' if span else ''}"
        if is_dataclass(value):
            yield f"{indent}{name}:"
            yield from _described(value, depth + 1)
        else:
            yield f"{indent}{name}: {_flow(value)}"


def _flow(value: Any) -> str:
    return yaml.safe_dump(_plain(value), default_flow_style=True).strip().removesuffix("...").strip()


def _plain(value: Any) -> Any:
    """A setting as JSON and YAML have it."""
    if isinstance(value, tuple):
        return [item.kind if isinstance(item, ThreadSpec) else item for item in value]
    return value
