"""Conditions of an experiment: its cells in words, with their doses in physical units."""

from typing import TYPE_CHECKING, Any

from dslab.experiments.eq1.records import SHAM
from dslab.experiments.eq1.units import system_label
from dslab.experiments.report.describe import listed
from dslab.scenarios.describe import (
    describe_camera,
    describe_field,
    describe_kind,
    describe_motion,
    describe_world,
    label_and_unit,
    plain,
)
from dslab.scenarios.describe_family import describe_parameter
from dslab.scenarios.distributions import is_distribution, parse_distribution

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec

_ABBREVIATIONS = ("orb", "sift", "gms")


def conditions(spec: "ExperimentSpec") -> list[dict[str, Any]]:
    """Describe every cell, in the order of the spec.

    Returns:
        Per cell its ``number`` from 1 and name, the ``kind`` of degradation, the ``dose`` in words, as
        ``value`` and its ``field``, the ``axis`` label of such doses, the ``severity`` that stands for
        the dose in the records, the ``name`` of all that, and the same without the system as ``stress``.
    """
    return [_condition(spec, number, name) for number, name in enumerate(spec.cells, 1)]


def _condition(spec: "ExperimentSpec", number: int, name: str) -> dict[str, Any]:
    cell = spec.cells[name]
    place = cell.image.split("/")
    found = {"number": number, "cell": name, "kind": SHAM, "field": "", "dose": "none"}
    found |= {"value": 0.0, "axis": "", "severity": 0.0}
    stress = [*place[:-1], "no stress"]
    if cell.degradation is not None and cell.dose is not None:
        degradation = spec.degradations[cell.degradation]
        label, field = degradation.label, degradation.dose
        value = degradation.doses_of(cell.base)[cell.dose]
        dose = describe_field(field, value)
        found |= {"kind": label, "field": field, "dose": dose, "value": value, "axis": axis_label(field)}
        found["severity"] = degradation.severities_of(cell.base)[cell.dose]
        together = f"{plain(value)}{label_and_unit(field)[1]}"  # a value is not parted from its unit
        together = dose.replace(together, together.replace(" ", "\N{NO-BREAK SPACE}"))
        stress = [*place[:-2], describe_label(label), together]
    named = ", ".join(stress)
    system = f" ({system_label(cell.system)})" if name != cell.image else ""
    return found | {"stress": named, "name": f"{named}{system}"}


def describe_base(spec: "ExperimentSpec", cell: str) -> dict[str, str]:
    """Describe ``world``, ``motion`` and ``camera`` of a cell's units in physical units and as drawn."""
    scenario = spec.unit(cell, 0).scenario
    found = {}
    for name, part, describe in (
        ("world", "world", describe_world),
        ("motion", "trajectory", describe_motion),
        ("camera", "camera", describe_camera),
    ):
        words, values = describe(scenario), getattr(scenario, part)
        written = [node for variant in spec.cells[cell].written for node in variant[part].items()]
        for field, node in written:
            if is_distribution(node) and hasattr(values, field):
                drawn = f"{label_and_unit(field)[0]} {describe_parameter(field, parse_distribution(node))}"
                words = words.replace(describe_field(field, getattr(values, field)), drawn)
        found[name] = words
    return found


def axis_label(field: str) -> str:
    """Label of an axis of doses, with their unit."""
    label, unit = label_and_unit(field)
    return f"{label} ({unit.strip()})" if unit and label != unit.strip() else label


def describe_label(label: str) -> str:
    """Name a kind of degradation as the records call it: ``defocus-creeping`` is creeping defocus."""
    kind = label.removesuffix("-creeping")
    return describe_kind(kind) if kind == label else f"creeping {describe_kind(kind)}"


def doses_of(found: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    """Conditions of a kind of degradation, one per dose, in the order of the spec."""
    return list({c["severity"]: c for c in reversed(found) if c["kind"] == kind}.values())[::-1]


def describe_stress(found: list[dict[str, Any]], kind: str) -> str:
    """Name a kind of degradation with its doses: ``motion blur (exposure 0.1 and 0.2 s)``."""
    doses = doses_of(found, kind)
    if kind == SHAM:
        return "no stress"
    label, unit = label_and_unit(doses[0]["field"])
    values = listed([plain(dose["value"]) for dose in doses])
    return f"{describe_label(kind)} ({'' if label == unit.strip() else label + ' '}{values}{unit})"


def thread_names(report: dict[str, Any]) -> list[str]:
    """Name each recovery thread of a report, equal kinds with their places."""
    kinds = [_thread_name(thread["kind"]) for thread in report["experiment"]["threads"]]
    return [
        f"{kind} ({kinds[:i].count(kind) + 1})" if kinds.count(kind) > 1 else kind
        for i, kind in enumerate(kinds)
    ]


def _thread_name(kind: str) -> str:
    own = kind.removeprefix("paper_")
    name = own.upper() if own in _ABBREVIATIONS else own
    return name if kind == own else f"the paper's {name}"
