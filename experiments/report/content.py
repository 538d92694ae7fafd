"""All figures of a report as one object: exact in report.json, rounded on the page."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from dslab.experiments.eq1.records import SHAM, failure_column
from dslab.experiments.eq1.units import system_label
from dslab.experiments.report import outcomes, reproductions
from dslab.experiments.report.answer import answer
from dslab.experiments.report.conditioning import conditioning
from dslab.experiments.report.conditions import conditions
from dslab.experiments.report.describe import plural
from dslab.experiments.report.plain_data import as_data
from dslab.experiments.report.systems import asks_eq1, beside_each_other, labels, sham_warnings
from dslab.experiments.runs import provenance
from dslab.experiments.statistics.analysis import analyse

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec

FORMAT = 2
PAPER_THREAD, PAPER_THREADS = "paper_orb", ("paper_orb", "paper_sift")
"""Kind of the thread nearest to Algorithm 1's thread 1; on our corners and start."""


def report_content(
    spec: "ExperimentSpec", table: pd.DataFrame, folder: Path, permutations: int | None = None
) -> dict[str, Any]:
    """Analyse the records of an experiment and return the figures as plain data.

    Args:
        spec: the ExperimentSpec.
        table: the records so far, with the columns of `records.columns`.
        folder: folder of the experiment, for commands that replay units.
        permutations: of the tests; None for as many as the number of tests takes.

    Returns:
        Dicts, lists and Python scalars; floats unrounded; null for an end of an interval that is unbounded.
    """
    cells = spec.cell_names()
    families = {name: cell.image.split("/")[0] for name, cell in spec.cells.items() if asks_eq1(cell)}
    systems = {name: system_label(cell.system) for name, cell in spec.cells.items() if asks_eq1(cell)}
    # All units of a cell have the same frame rate and duration.
    scenarios = {cell: spec.unit(cell, 0).scenario for cell in cells}
    whole = _in_order_of_cells(table, cells)
    # Eq. 1 is about systems with recovery threads; all others stand beside them.
    table = outcomes.rows_where(whole, whole["cell"].isin(list(systems)))
    threads = len(spec.threads)
    kinds = [thread.kind for thread in spec.threads]
    letter = tuple(kinds.index(kind) + 1 for kind in PAPER_THREADS if kind in kinds)
    analysis = as_data(
        analyse(
            table,
            threads,
            spec.confirmatory,
            letter,
            permutations=permutations,
            confirmatory_threads=spec.confirmatory_threads,
        )
    )
    table = table.assign(dual_failure=table[failure_column("s", threads)])
    free = "free" in spec.arms
    told = table if free else table.head(0)
    units = outcomes.unit_counts(whole, {cell: spec.units_of(cell) for cell in cells})
    results = {
        "format": FORMAT,
        "experiment": _about(spec),
        "reanalysed": bool((table.groupby("cell")["world"].nunique() > 1).any()),
        "asks_eq1": bool(systems),
        "free_arm": free,
        "conditions": conditions(spec),
        "units": units,
        "worlds_of_kinds": outcomes.worlds_of_kinds(table),
        "warnings": _warnings(units, whole, threads, folder),
        "systems": beside_each_other(spec, whole),
        "analysis": analysis,
        "lengths": _lengths(table),
        "conditioning": conditioning(analysis, table),
        "tables": {
            "table_1": reproductions.table_1(table),
            **reproductions.tables_2_and_3(table, threads, families, systems),
        },
        "initialisation": reproductions.initialisation(
            table, systems, {cell: scenario.camera.fps for cell, scenario in scenarios.items()}
        ),
        "timeline": reproductions.timeline(
            told, {cell: scenario.frame_count for cell, scenario in scenarios.items()}
        ),
        "end_errors": reproductions.end_errors(told),
        "taxonomy": outcomes.taxonomy(table, threads),
        "failures": outcomes.failures(whole, threads, folder),
        "set_aside": outcomes.set_aside(whole, labels(spec)),
        "costs": outcomes.costs(whole),
        "sources": outcomes.sources(whole) | {"report_commit": provenance.commit()},
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


def _warnings(units: dict[str, Any], table: pd.DataFrame, threads: int, folder: Path) -> list[str]:
    warnings = sham_warnings(table, threads, folder)
    if units["missing"]:
        warnings.append(
            f"{units['missing']} of {units['planned']} planned trials are not recorded: figures will change."
        )
    for name, what in (("code", "the sources of sim, scenarios and slam"), ("commit", "the repository")):
        versions = len(set(table[name].dropna()))
        if versions > 1:
            warnings.append(f"The records are of {versions} states of {what}: they may not be comparable.")
    if codes := set(table["code"].dropna()) - {provenance.code_hash()}:
        warnings.append(
            f"{plural(len(codes), 'state')} of the code that made the records is not that of this report: "
            "replays may differ."
        )
    stressed = outcomes.rows_where(table, table["kind"] != SHAM)
    if unknown := int(stressed["exposed"].isna().sum()):
        warnings.append(
            f"Of {plural(unknown, 'trial')} it is not known whether the stress acted: a condition that mixes "
            "stressed with unstressed trials contradicts Eq. 1 by itself."
        )
    digests = table.groupby("system")["system_digest"].nunique()
    changed = [str(name) for name, count in digests.items() if int(count) > 1]
    warnings += [f"{name} was changed between records: they may not be comparable." for name in changed]
    dirty = sum(str(commit).endswith("-dirty") for commit in table["commit"].dropna())
    if dirty:
        warnings.append(f"{dirty} records are of a work tree with uncommitted changes.")
    return warnings


def _lengths(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Frames to cross in both arms."""
    return [
        {
            "cell": cell,
            **{
                arm: outcomes.spread(own[f"{arm}_frames_to_cross"].astype("Float64"))
                for arm in ("free", "cross")
            },
        }
        for cell, own in outcomes.completed(table).groupby("cell", sort=False)
    ]
