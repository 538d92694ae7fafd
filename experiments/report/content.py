"""All figures of a report as one object: exact in report.json, rounded on the page."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from experiments.eq1.records import SHAM, failure_column
from experiments.report import outcomes, reproductions
from experiments.report.answer import answer
from experiments.report.conditioning import conditioning
from experiments.report.conditions import conditions
from experiments.report.plain_data import as_data
from experiments.report.verdict import verdict
from experiments.runs import provenance
from experiments.statistics.analysis import AnalysisSettings, analyse
from experiments.statistics.kinds_of_world import kinds_of_world

if TYPE_CHECKING:
    from experiments.eq1.spec import ExperimentSpec

FORMAT = 1


def report_content(
    spec: "ExperimentSpec", table: pd.DataFrame, folder: Path, settings: AnalysisSettings | None = None
) -> dict[str, Any]:
    """Analyse the records of an experiment and return the figures as plain data.

    Args:
        spec: the ExperimentSpec.
        table: the records so far, with the columns of `records.columns`.
        folder: folder of the experiment, for commands that replay units.
        settings: settings of the analysis; the defaults if None.

    Returns:
        Dicts, lists and Python scalars; floats unrounded.
    """
    cells = spec.cell_names()
    families = {name: cell.image.split("/")[0] for name, cell in spec.cells.items()}
    systems = {name: str(cell.system) for name, cell in spec.cells.items()}
    found = conditions(spec)
    # All units of a cell have the same frame rate and duration.
    scenarios = {cell: spec.unit(cell, 0).scenario for cell in cells}
    table = _in_order_of_cells(table, cells)
    threads = len(spec.threads)
    table = table.assign(dual_failure=table[failure_column("s", threads)])
    methods = tuple(thread.kind for thread in spec.threads)
    settings = replace(settings or AnalysisSettings(), thread_methods=methods)
    stressed = table[table["kind"] != SHAM]
    analysis = as_data(analyse(stressed, threads, settings))
    analysis["cells"].sort(key=lambda cell: cells.index(cell["cell"]))
    kinds = [condition["kind"] for condition in found]
    analysis["dose_response"].sort(key=lambda fit: kinds.index(fit["kind"]))
    kinds_apart = as_data(kinds_of_world(stressed, threads, settings.confidence))
    units = outcomes.unit_counts(table, {cell: spec.units_of(cell) for cell in cells})
    results = {
        "format": FORMAT,
        "experiment": _about(spec),
        "conditions": found,
        "units": units,
        "warnings": _warnings(units, table),
        "verdict": verdict(analysis),
        "kinds_of_world": kinds_apart,
        "calibration": _calibration(analysis, cells),
        "analysis": analysis,
        "lengths": _lengths(analysis, table),
        "conditioning": conditioning(analysis, table),
        "tables": {
            "table_1": reproductions.table_1(table),
            "table_2": reproductions.table_2(table, threads, families, systems),
            "table_3": reproductions.table_3(table, threads, families, systems),
        },
        "initialisation": reproductions.initialisation(
            table, systems, {cell: scenario.camera.fps for cell, scenario in scenarios.items()}
        ),
        "timeline": reproductions.timeline(
            table, {cell: scenario.frame_count for cell, scenario in scenarios.items()}
        ),
        "end_errors": reproductions.end_errors(table),
        "taxonomy": outcomes.taxonomy(table, threads),
        "failures": outcomes.failures(table, threads, folder),
        "set_aside": outcomes.set_aside(table),
        "costs": outcomes.costs(table),
        "sources": outcomes.sources(table) | {"report_commit": provenance.commit()},
        "versions": provenance.versions(),
    }
    return {"answer": as_data(answer(results)), **results}


def _in_order_of_cells(table: pd.DataFrame, cells: list[str]) -> pd.DataFrame:
    """Records in the order of cells in the spec, then of units."""
    places = {cell: place for place, cell in enumerate(cells)}
    place = table["cell"].map(places).fillna(len(cells))
    return table.assign(_place=place).sort_values(["_place", "index"], kind="stable").drop(columns="_place")


def _about(spec: "ExperimentSpec") -> dict[str, Any]:
    data = spec.model_dump(mode="json")
    return {
        "name": spec.name,
        "content_hash": spec.content_hash,
        "threads": [thread.model_dump(mode="json") for thread in spec.threads],
        "spec": data,
        "spec_yaml": spec.as_yaml(),
    }


def _warnings(units: dict[str, Any], table: pd.DataFrame) -> list[str]:
    warnings = []
    if units["missing"]:
        warnings.append(
            f"{units['missing']} of {units['planned']} planned trials are not recorded: figures will change."
        )
    for name, what in (("code", "the sources of sim, scenarios and slam"), ("commit", "the repository")):
        versions = len(set(table[name].dropna()))
        if versions > 1:
            warnings.append(f"The records are of {versions} states of {what}: they may not be comparable.")
    dirty = sum(str(commit).endswith("-dirty") for commit in table["commit"].dropna())
    if dirty:
        warnings.append(f"{dirty} records are of a work tree with uncommitted changes.")
    return warnings


def _calibration(analysis: dict[str, Any], cells: list[str]) -> list[dict[str, Any]]:
    """One point per cell and n; cells are numbered from 1 in the order of the spec."""
    names = ("n", "predicted", "measured", "ratio", "verdict", "holm_p", "power_ratio_2")
    return [
        {"number": cells.index(cell["cell"]) + 1, "cell": cell["cell"]}
        | {name: level[name] for name in names}
        for cell in analysis["cells"]
        for level in cell["levels"]
    ]


def _lengths(analysis: dict[str, Any], table: pd.DataFrame) -> list[dict[str, Any]]:
    """Frames to cross in both arms, and the effect of the difference on a prediction."""
    completed = outcomes.completed(table)
    rows = []
    for cell in analysis["cells"]:
        own = completed[completed["cell"] == cell["cell"]]
        free, crossing = (
            outcomes.spread(own[f"{arm}_frames_to_cross"].astype("Float64")) for arm in ("free", "cross")
        )
        rows.append(
            {
                "cell": cell["cell"],
                "free": free,
                "crossing": crossing,
                "ratio": _ratio(free["median"], crossing["median"]),
                "levels": [
                    {
                        "n": level["n"],
                        "predicted": level["predicted"]["value"],
                        "predicted_at_free_length": level["predicted_at_free_length"],
                        "measured": level["measured"]["estimate"],
                    }
                    for level in cell["levels"]
                ],
            }
        )
    return rows


def _ratio(part: float | None, whole: float | None) -> float | None:
    return part / whole if part is not None and whole else None
