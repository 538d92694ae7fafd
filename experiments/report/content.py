"""Every figure of a report as one object: what report.json holds and the page shows rounded."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from experiments.report import outcomes, reproductions
from experiments.report.conditioning import conditioning
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
    """Analyse an experiment's records and put all that is to be told into plain data.

    Args:
        spec: the ExperimentSpec.
        table: its records, as many as there are, with the columns of `records.columns`.
        folder: of the experiment, for commands that replay units.
        settings: of the analysis; the default ones if None.

    Returns:
        Dicts, lists and Python scalars; floats as computed.
    """
    cells = spec.cell_names()
    families = {name: cell.image.split("/")[0] for name, cell in spec.cells.items()}
    systems = {name: str(cell.system) for name, cell in spec.cells.items()}
    # Frame rate and duration are alike in all units of a cell.
    scenarios = {cell: spec.unit(cell, 0).scenario for cell in cells}
    table = _in_order_of_cells(table, cells)
    threads = len(spec.threads)
    kinds = tuple(thread.kind for thread in spec.threads)
    settings = replace(settings or AnalysisSettings(), thread_methods=kinds)
    analysis = as_data(analyse(table, threads, settings))
    kinds_apart = as_data(kinds_of_world(table, threads, settings.confidence))
    units = outcomes.unit_counts(table, {cell: spec.units_of(cell) for cell in cells})
    return {
        "format": FORMAT,
        "experiment": _about(spec),
        "units": units,
        "warnings": _warnings(units, table),
        "verdict": verdict(analysis, kinds_apart),
        "kinds_of_world": kinds_apart,
        "calibration": _calibration(analysis),
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


def _in_order_of_cells(table: pd.DataFrame, cells: list[str]) -> pd.DataFrame:
    """By cell as the spec names them, then by number of unit."""
    places = {cell: place for place, cell in enumerate(cells)}
    place = table["cell"].map(places).fillna(len(cells))
    return table.assign(_place=place).sort_values(["_place", "index"], kind="stable").drop(columns="_place")


def _about(spec: "ExperimentSpec") -> dict[str, Any]:
    data = spec.model_dump(mode="json")
    return {
        "name": spec.name,
        "content_hash": spec.content_hash,
        "threads": [thread.model_dump(mode="json") for thread in spec.threads],
        "stopping": data.get("stopping"),
        "spec": data,
        "spec_yaml": spec.as_yaml(),
    }


def _warnings(units: dict[str, Any], table: pd.DataFrame) -> list[str]:
    said = []
    if units["missing"]:
        said.append(
            f"{units['missing']} of {units['planned']} planned units are not recorded. While a run is going "
            "on, only the anytime-valid intervals of p0 hold however often one looks; where a stopping "
            "rule has ended a cell, its missing units are not wanted."
        )
    for name, what in (("code", "the sources of sim, scenarios and slam"), ("commit", "the repository")):
        versions = len(set(table[name].dropna()))
        if versions > 1:
            said.append(f"The records are of {versions} states of {what}: they may not be comparable.")
    dirty = sum(str(commit).endswith("-dirty") for commit in table["commit"].dropna())
    if dirty:
        said.append(f"{dirty} records are of a work tree with uncommitted changes.")
    return said


def _calibration(analysis: dict[str, Any]) -> list[dict[str, Any]]:
    """One mark per cell and n; cells are numbered from 1 in their order."""
    wanted = ("n", "predicted", "measured", "ratio", "verdict", "holm_p", "power_ratio_2")
    return [
        {"number": place, "cell": cell["cell"]} | {name: level[name] for name in wanted}
        for place, cell in enumerate(analysis["cells"], 1)
        for level in cell["levels"]
    ]


def _lengths(analysis: dict[str, Any], table: pd.DataFrame) -> list[dict[str, Any]]:
    """Frames to cross in both arms, and how far the difference alone would change a prediction."""
    done = outcomes.completed(table)
    rows = []
    for cell in analysis["cells"]:
        own = done[done["cell"] == cell["cell"]]
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
