"""A unit of an experiment as data: everything that determines its record."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from pydantic import Field

from dslab.experiments.evaluation.breakages import EXPOSURE_GRACE_S
from dslab.experiments.runs.slam_settings import SlamSettings, parse_slam_settings
from dslab.scenarios.errors import InputError
from dslab.scenarios.spec import Scenario
from dslab.scenarios.strict import Strict
from dslab.scenarios.yaml_file import Location
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS

ArmName = Literal["free", "crossing", "pairs"]
RECOVERING = ("dual", "dual+", "paper", "paper+")
"""Systems with recovery threads: Eq. 1 is about them. All others run the free arm alone."""


_ROUNDING_S = 1e-6


def system_label(system: str) -> str:
    """Name of a system in cells and records: of ``module:Class`` the class, also within ``dual()``."""
    return re.sub(r"[^(,=\s]*:|\s", "", system)


class ThreadChoice(Strict):
    """One of the n recovery threads."""

    kind: str = Field(description=f"one of {', '.join(sorted(RECOVERY_KINDS))}")
    seed: int = Field(0, ge=0, description="distinguishes threads of one kind")
    config: dict[str, Any] = Field(
        default_factory=dict, description="its own settings, as in a settings file of `dslab run`"
    )


class UnitSpec(Strict):
    """One unit of one cell.

    Attributes:
        experiment: name of the experiment it belongs to.
        cell: name of the cell, such as ``motion_blur/2``.
        base: name of its base in the spec: one kind of world and of motion.
        kind: kind of the degradation of the cell, such as ``motion_blur``; ``sham`` for none.
        severity: dose of the degradation, in the unit that the experiment states.
        index: number of the unit in its cell, from 0.
        sequence, repeat: number of its sequence in its world, and of the replicate in its sequence.
        world_seed, sequence_seed: of the world; of path, camera and draws of the segment.
        repeat_seed: of sensor noise, start frame, SLAM and threads.
        scenario: as drawn with these seeds: lead-in, exposed segment with the degradation, tail.
        start_frame: first frame of the scenario that is fed to the systems.
        onset_s, exposed_s: start and length of the exposed segment.
        threads: the recovery threads, in order; n of Eq. 1 is their number.
        system: as the experiment names it. One with recovery threads is run in the free arm besides the
            base, and in the crossing arm; any other one in the free arm alone.
        settings: of base and system, as in a settings file of ``dslab run``.
        arms: the arms to run; ``pairs`` measures pose error against baseline in the lead-in, without a SLAM.
    """

    experiment: str
    cell: str
    base: str = ""
    kind: str
    severity: float
    index: int = Field(ge=0)
    sequence: int = Field(0, ge=0)
    repeat: int = Field(0, ge=0)
    world_seed: int = Field(ge=0)
    sequence_seed: int = Field(ge=0)
    repeat_seed: int = Field(ge=0)
    scenario: Scenario
    start_frame: int = Field(0, ge=0)
    onset_s: float = Field(gt=0)
    exposed_s: float = Field(gt=0)
    threads: tuple[ThreadChoice, ...] = Field(min_length=1)
    system: str = "dual"
    settings: dict[str, Any] = Field(default_factory=dict)
    arms: tuple[ArmName, ...] = ("free", "crossing")

    @property
    def recovers(self) -> bool:
        """True if its system has recovery threads."""
        return self.system in RECOVERING

    @property
    def unit_id(self) -> str:
        """Sixteen hexadecimal digits of the content hash."""
        return content_hash(self.model_dump(mode="json"))[:16]


@dataclass(frozen=True)
class Exposure:
    """The exposed segment.

    Attributes:
        onset_s, exposed_s: start and length.
        onset_frame, end_frame: its first and last frame.
        last_frame: last frame at which a breakage is still attributed to it.
    """

    onset_s: float
    exposed_s: float
    onset_frame: int
    end_frame: int
    last_frame: int

    @staticmethod
    def of(onset_s: float, exposed_s: float, stamps_s: np.ndarray) -> "Exposure":
        """Find the exposed segment in the times (N,) of the frames.

        Raises:
            ValueError: there is no frame before it, in it or after it.
        """
        onset = int(np.searchsorted(stamps_s, onset_s - _ROUNDING_S))
        end = int(np.searchsorted(stamps_s, onset_s + exposed_s - _ROUNDING_S)) - 1
        if not 0 < onset <= end < len(stamps_s) - 1:
            raise ValueError(f"the exposed segment is frames {onset} to {end} of {len(stamps_s)}")
        last = int(np.searchsorted(stamps_s, stamps_s[end] + EXPOSURE_GRACE_S, "right")) - 1
        return Exposure(onset_s, exposed_s, onset, end, last)

    @property
    def columns(self) -> dict[str, float]:
        """Its columns in the record."""
        return {name: value for name, value in vars(self).items() if name != "last_frame"}


# What the design of the experiment sets.
_OWN = ("recovery_threads", "exhaustive", "relocalization", "place_merging")


def unit_settings(
    settings: Mapping[str, Any],
    threads: Sequence[ThreadChoice],
    where: Callable[[Location], str] = lambda at: ".".join(map(str, at)),
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


def content_hash(data: Any) -> str:
    """SHA-256 of JSON-like data, independent of the order of keys."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
