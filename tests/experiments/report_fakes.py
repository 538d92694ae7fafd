"""Synthetic experiments for the tests of reports: a spec and records with known outcomes."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pandas as pd

from dslab.experiments.eq1.records import columns, dual_column, thread_column
from dslab.experiments.eq1.spec_parts import Degradation
from dslab.experiments.eq1.units import ThreadChoice

KINDS = ("low_texture", "motion_blur", "fast_rotation")
_DOSES = (
    ("contrast", (0.3, 0.1, 0.03), (1.0, 2.0, 3.0)),
    ("exposure_s", (1.0, 2.0, 3.0), None),
    ("rate_degps", (1.0, 2.0, 3.0), None),
)
_TYPES = {"bool": "boolean", "int": "Int64", "float": "Float64", "text": "string"}
_FRAMES_PER_S, _ONSET, _END = 20, 100, 299


@dataclass(frozen=True)
class FakeSpec:
    """The part of an ExperimentSpec that a report uses: three kinds of degradation in some doses."""

    units: int = 40
    doses: int = 3
    threads: tuple[ThreadChoice, ...] = (ThreadChoice(kind="orb"), ThreadChoice(kind="sift"))
    systems: tuple[str, ...] = ("dual",)
    confirmatory: tuple[str, ...] = ()
    confirmatory_threads: int | None = None
    name: str = "made-up"
    content_hash: str = "5bec"
    frames: int = 500
    arms: tuple[str, ...] = ("free", "crossing")

    @property
    def cells(self) -> dict[str, SimpleNamespace]:
        images = [f"{kind}/{dose + 1}" for kind in KINDS for dose in range(self.doses)]
        return {
            f"{image}/{system}" if len(self.systems) > 1 else image: SimpleNamespace(
                image=image,
                base="passage",
                system=system,
                degradation=place // self.doses,
                dose=place % self.doses,
            )
            for place, image in enumerate(images)
            for system in self.systems
        }

    @property
    def degradations(self) -> list[Degradation]:
        return [
            Degradation(kind=kind, dose=dose, doses=doses, severities=severities)
            for kind, (dose, doses, severities) in zip(KINDS, _DOSES, strict=True)
        ]

    replicates_per_world = 1

    def cell_names(self) -> list[str]:
        return list(self.cells)

    def units_of(self, cell: str) -> int:
        return self.units

    def unit(self, cell: str, index: int) -> SimpleNamespace:
        return SimpleNamespace(
            scenario=SimpleNamespace(frame_count=self.frames, camera=SimpleNamespace(fps=_FRAMES_PER_S)),
            cell=cell,
            index=index,
        )

    def model_dump(self, mode: str) -> dict:
        return {"name": self.name, "units": self.units, "arms": self.arms, "description": "<b>Made</b> up."}

    def as_yaml(self) -> str:
        return f"name: {self.name}\nunits: {self.units}\n"


def fake_table(
    spec: FakeSpec,
    seed: int = 0,
    units: int | None = None,
    shared: float = 0.3,
    hardness: float = 0.0,
    code: str = "c0de",
    per_world: int = 2,
) -> pd.DataFrame:
    """Records of units whose difficulty is shared by breakage and recoveries to a degree.

    Args:
        spec: of which the units are.
        seed: of all draws.
        units: per cell; all planned ones if None.
        shared: share of units in which everything fails alike.
        hardness: added to every dose.
        code: hash of the sources.
        per_world: units of a world.
    """
    rng = np.random.default_rng(seed)
    rows = [
        _row(spec, rng, cell, index, shared, hardness, code, per_world)
        for cell in spec.cell_names()
        for index in range(spec.units_of(cell) if units is None else units)
    ]
    types = columns(len(spec.threads))
    table = pd.DataFrame(rows, columns=list(types))
    return table.astype({name: _TYPES[kind] for name, kind in types.items()})


def _row(spec, rng, cell, index, shared, hardness, code, per_world) -> dict:
    kind, dose = cell.split("/")[:2]
    row = dict.fromkeys(columns(len(spec.threads))) | {
        "unit_id": f"{rng.integers(2**63):016x}",
        "experiment": spec.name,
        "cell": cell,
        "kind": kind,
        "severity": float(dose),
        "index": index,
        "world": "corridor",
        "world_seed": 1000 + index // per_world,
        "sequence": index % per_world,
        "repeat": 0,
        "code": code,
        "commit": "0123abc",
        "outcome": "completed",
        "message": "",
        "attempts": 1,
        "onset_s": _ONSET / _FRAMES_PER_S,
        "exposed_s": 10.0,
        "onset_frame": _ONSET,
        "end_frame": _END,
        "render_s": 3.0,
        "slam_s": 9.0,
        "cpu_s": 12.5,
        "wall_s": 13.0,
        "peak_rss_mb": 700.0 + index,
    }
    fate = rng.random()
    if fate < 0.04:
        return row | {"outcome": "void", "void_reason": "lost in the lead-in"}
    if fate < 0.06:
        return row | {"outcome": "infrastructure_error", "message": "timeout after 600 s", "attempts": 3}
    _add_outcomes(row, rng, float(dose) + hardness, shared, len(spec.threads))
    return row


def _add_outcomes(row: dict, rng, dose: float, shared: float, threads: int) -> None:
    chance = 1 / (1 + np.exp(-(dose - 2.4) * 1.5))
    hopeless = rng.random() < shared * chance
    broke = bool(hopeless or rng.random() < chance * 0.8)
    reinit = bool(rng.random() > 0.05)
    all_failed = broke
    for thread in range(1, threads + 1):
        crossing_failed = bool(hopeless or rng.random() < chance * 0.5 / thread)
        _add_thread(row, rng, "cross", thread, crossing_failed, reinit=True)
        if broke:
            failed = bool(not reinit or hopeless or rng.random() < chance * 0.5 / thread)
            all_failed = all_failed and failed
            _add_thread(row, rng, "free", thread, failed, reinit)
        row[dual_column(thread)] = all_failed
    declared = [j for j in range(1, threads + 1) if row.get(thread_column("free", j, "declared"))]
    row[f"s{threads}"] = broke and (not declared or row[thread_column("free", declared[0], "failed")])
    base_failure = bool(broke and rng.random() < 0.9)
    row |= {
        "breakage": broke,
        "silent_failure": bool(not broke and rng.random() < 0.05),
        "base_failure": base_failure,
        "base_share_tracked": 0.5 if base_failure else 0.98,
        "base_keyframe_ate_m": 0.5,
        "base_ate_m": 0.02 + 0.1 * rng.random(),
        "base_path_share": 0.4 if base_failure else 1.0,
        "base_end_error_m": None if base_failure else float(rng.lognormal(-2, 1)),
        "dual_share_tracked": 0.6 if all_failed else 0.97,
        "dual_ate_m": 0.02 + 0.12 * rng.random(),
        "dual_path_share": 0.5 if all_failed else 1.0,
        "dual_end_error_m": None if all_failed else float(rng.lognormal(-2, 1)),
        "cross_reinit": True,
        "cross_reinit_frame": _END + 12,
        "cross_frames_to_cross": _END + 12 - _ONSET,
    }
    if broke:
        frame = int(rng.integers(_ONSET + 10, _END - 40))
        again = frame + int(rng.integers(20, 90)) if reinit else None
        row |= {
            "breakage_frame": frame,
            "breakage_reason": str(rng.choice(["too few inliers", "too few matches"])),
            "declaration_delay_s": float(rng.exponential(0.4)),
            "relocalized": not base_failure,
            "reinit": reinit,
            "reinit_frame": again,
            "free_frames_to_cross": None if again is None else again - frame + 15,
        }
    for name, value in list(row.items()):
        if isinstance(value, np.generic):
            row[name] = value.item()


def _add_thread(row: dict, rng, arm, thread: int, failed: bool, reinit: bool) -> None:
    false = bool(failed and reinit and rng.random() < 0.1)
    stage = (
        "no_reinit"
        if not reinit
        else "audit"
        if false
        else str(rng.choice(["propagation", "overlap", "sim3"]))
    )
    named = {
        "failed": failed,
        "declared": not failed or false,
        "false": false if not failed or false else None,
        "stage": stage if failed else None,
        "reason": f"{stage} gave up" if failed else None,
        "frames_covered": int(rng.integers(20, 120)),
        "cpu_ms": float(rng.uniform(300, 3000)),
    }
    row |= {thread_column(arm, thread, name): value for name, value in named.items()}
