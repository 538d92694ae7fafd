"""Settings of the systems of a unit: those that the spec gives, but only recovery may repair a breakage."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from dslab.experiments.eq1.units import ThreadChoice
from dslab.experiments.runs.slam_settings import SlamSettings, parse_slam_settings
from dslab.scenarios.errors import InputError
from dslab.scenarios.yaml_file import Location

# What the design of the experiment sets.
_OWN = ("recovery_threads", "exhaustive", "relocalization", "place_merging")


def unit_settings(
    settings: Mapping[str, Any], threads: Sequence[ThreadChoice], where: Callable[[Location], str]
) -> SlamSettings:
    """The settings of a unit's systems.

    Relocalization in saved maps and place-based merging are off: they would prevent recovery, or be counted
    as recovery. Every thread is run to its end.

    Args:
        settings: of the spec, as in a settings file.
        threads: the recovery threads, with settings of their own.
        where: file, line and field of a location in the spec.

    Raises:
        InputError: an unknown key, a value of the wrong type or range, or a setting of the design.
    """
    dual = settings.get("dual") or {}
    for at in (("mode",), *(("dual", name) for name in _OWN)):
        if at[-1] in (dual if len(at) > 1 and isinstance(dual, Mapping) else settings):
            raise InputError(where(("settings", *at)), "is set by the experiment", "leave it out")

    def locate(at: Location) -> str:
        given = at[:2] == ("dual", "recovery_threads")
        return where(("threads", *at[2:]) if given else ("settings", *at))

    chosen = [{"kind": t.kind, "seed": t.seed, "config": dict(t.config) or None} for t in threads]
    if isinstance(dual, Mapping):
        dual = {**dual, "recovery_threads": chosen}
    parsed = parse_slam_settings({**settings, "dual": dual}, (), locate)
    design = {"exhaustive": True, "relocalization": False, "place_merging": None}
    return replace(parsed, dual_options=design)
