"""A unit of an experiment as data: everything that determines its record."""

import hashlib
import json
from typing import Any, Literal

from pydantic import Field

from dslab.scenarios.spec import Scenario
from dslab.scenarios.strict import Strict
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS

ArmName = Literal["free", "crossing", "pairs"]
RECOVERING = ("dual", "dual+", "paper", "paper+")
"""Systems with recovery threads: Eq. 1 is about them. All others run the free arm alone."""


def system_label(system: str) -> str:
    """Name of a system in cells and records: of ``module:Class`` the class."""
    return system.rpartition(":")[2]


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
        onset_s, exposed_s: the exposed segment; None for that of the scenario's first injected segment.
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
    onset_s: float | None = Field(None, ge=0)
    exposed_s: float | None = Field(None, gt=0)
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


def content_hash(data: Any) -> str:
    """SHA-256 of JSON-like data, independent of the order of keys."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
