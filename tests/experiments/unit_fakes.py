"""A synthetic experiment with quick units: the name of a cell says what its units do."""

import os
import re
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import yaml

from dslab.experiments.campaign.folder import open_ledger
from dslab.experiments.eq1.records import (
    SHAM,
    decided,
    dual_column,
    empty_record,
    failure_column,
    thread_column,
)
from dslab.experiments.eq1.units import ThreadChoice, UnitSpec, content_hash
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import RoomWorld, Scenario


@dataclass(frozen=True)
class MadeUp:
    """Cells by name, each with its budget."""

    cells: dict[str, int]
    name: str = "made-up"
    threads: tuple[ThreadChoice, ...] = (ThreadChoice(kind="orb"), ThreadChoice(kind="sift"))
    root_seed: int = 0
    replicates_per_world: int = 1

    @property
    def content_hash(self) -> str:
        return content_hash([self.name, list(self.cells), self.root_seed, len(self.threads)])

    def cell_names(self) -> list[str]:
        return list(self.cells)

    def units_of(self, cell: str) -> int:
        return self.cells[cell]

    def unit(self, cell: str, index: int) -> UnitSpec:
        seed = int(rng_for(self.root_seed, "unit", index).integers(2**53))
        return UnitSpec(
            experiment=self.name, cell=cell, kind="made_up", severity=1.0, index=index,
            world_seed=seed, sequence_seed=seed, repeat_seed=seed,
            scenario=Scenario(name="made-up", world=RoomWorld(), seed=seed), onset_s=5.0, exposed_s=10.0,
            threads=self.threads,
        )  # fmt: skip

    def as_yaml(self) -> str:
        return yaml.safe_dump({"name": self.name, "cells": self.cells, "root_seed": self.root_seed})


def made_up_unit(unit: UnitSpec, cache_dir: Path | None = None, **_: object) -> dict:
    """Do what the cell says, up to the given number of tries; return a record drawn from the unit's seed."""
    what, *arguments = unit.cell.split("-")
    tries = _count_try(unit, cache_dir)
    if what == "slow":
        time.sleep(float(arguments[0]))
    elif arguments and tries > int(arguments[0]):
        pass
    elif what == "crash":
        signal.raise_signal(signal.SIGSEGV)
    elif what == "spin":
        # Compiled code that holds the interpreter's lock: nothing in Python could end it.
        re.match(r"(a+)+$", "a" * 60 + "b")
    elif what == "raise":
        raise ValueError("told to")
    elif what == "error":
        return empty_record(unit) | {"message": "no GL here"}
    elif what == "wrong":
        return {"unit_id": unit.unit_id}
    elif what == "odd":
        return made_up_record(unit) | {"outcome": "maybe"}
    return made_up_record(unit)


def slow_unit(unit: UnitSpec, cache_dir: Path | None = None, **_: object) -> dict:
    """Return a record after a moment, in every cell."""
    time.sleep(0.05)
    return made_up_record(unit)


def rendered_unit(unit: UnitSpec, cache_dir: Path | None = None, **_: object) -> dict:
    """Render a small scenario and return the hash of its frames in the record."""
    import hashlib

    from small_world import CAMERA, CORRIDOR

    from dslab.sim.sequence_rendering import render_sequence

    spec = {"name": "small", "duration_s": 1.0, "seed": unit.index, "world": CORRIDOR, "camera": CAMERA}
    frames = render_sequence(Scenario.model_validate(spec), cache_dir=cache_dir).frames
    digest = hashlib.sha256(b"".join(frame.tobytes() for frame in frames)).hexdigest()
    return made_up_record(unit) | {"outcome": "void", "void_reason": digest}


def planted_unit(unit: UnitSpec, cache_dir: Path | None = None, **_: object) -> dict:
    """A system that breaks ever more often: in half of the units at an exposure of 0.1 s, a contrast of 0.1.

    No recovery thread succeeds. One unit in ten is void. The machine fails in the unit whose index is in
    PLANTED_FAULT, or in all.
    """
    if os.environ.get("PLANTED_FAULT") in ("all", str(unit.index)):
        return empty_record(unit) | {"message": "no GL here"}
    rng = rng_for(unit.repeat_seed, "planted")
    uniform, void = rng.random(2)
    record = empty_record(unit) | {"code": "0", "commit": "0", "wall_s": time.perf_counter()}
    if void < 0.1:
        return record | {"outcome": "void", "void_reason": "drawn so"}
    sign = -1 if unit.kind == "low_texture" else 1
    rise = 0.0 if unit.kind == SHAM else 1 / (1 + (unit.severity / 0.1) ** (-4 * sign))
    broke = bool(uniform < rise)
    columns = {failure_column(f, n): broke for f in ("d", "s", "m") for n in range(1, len(unit.threads) + 1)}
    return record | {"outcome": "completed", "breakage": broke} | columns


def slow_planted_unit(unit: UnitSpec, cache_dir: Path | None = None, **_: object) -> dict:
    """The same after a moment."""
    time.sleep(0.2)
    return planted_unit(unit)


def made_up_record(unit: UnitSpec) -> dict:
    """A record determined by the unit's seed: p0 = 1/2, each thread fails in half of the cases."""
    rng = rng_for(unit.repeat_seed, unit.cell)
    record = empty_record(unit) | {"code": "0", "commit": "0", "wall_s": time.perf_counter()}
    if rng.random() < 0.1:
        return record | {"outcome": "void", "void_reason": "drawn so"}
    broke = bool(rng.random() < 0.5)
    record |= {"outcome": "completed", "breakage": broke, "base_ate_m": float(abs(rng.normal()))}
    whole = broke
    for thread in range(1, len(unit.threads) + 1):
        failed, crossed = (bool(x) for x in rng.random(2) < 0.5)
        record[thread_column("cross", thread, "failed")] = crossed
        if broke:
            record[thread_column("free", thread, "failed")] = failed
        whole = whole and failed
        record[dual_column(thread)] = whole
    return record


def rows_of(folder: Path, plan: MadeUp) -> list[dict]:
    """The rows of the ledger, without times."""
    with open_ledger(folder, plan, read_only=True) as ledger:
        return [decided(row) for row in ledger.rows()]


def _count_try(unit: UnitSpec, folder: Path | None) -> int:
    """Number of this try of a unit, counted in files."""
    if folder is None:
        return 1
    path = folder / f"{unit.unit_id}.tries"
    with path.open("a") as file:
        file.write("x")
    return path.stat().st_size
