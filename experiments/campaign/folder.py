"""The folder of an experiment: ``spec.yaml``, ``ledger.sqlite`` and, once exported, ``units.parquet``."""

import hashlib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dslab.experiments.campaign.schedule import Experiment
from dslab.experiments.campaign.table_file import (
    read_error_table,
    read_table,
    table_release,
    write_errors,
    write_table,
)
from dslab.experiments.eq1.record_table import data_frame, record_fault
from dslab.experiments.eq1.records import columns
from dslab.experiments.jobs.ledger import LEDGER_FILE, LOCK_FILE, Ledger, Owner, Row
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import SETTINGS_BYTES, is_given, read_bytes
from dslab.sim.io.folders import unwritable, write_file
from dslab.sim.unfinished import sweep

if TYPE_CHECKING:
    import pandas as pd

    from dslab.experiments.eq1.spec import ExperimentSpec

SPEC_FILE = "spec.yaml"
TABLE_FILE = "units.parquet"
ERRORS_FILE = "infrastructure_errors.parquet"
_MEND = (
    "add --rerun-damaged to `dslab experiment run`, which runs damaged units again, or choose a new folder"
)


def owner_of(experiment: Experiment) -> Owner:
    """The experiment as the owner of a ledger, whose rows are records in the order of its cells."""
    cells = {cell: place for place, cell in enumerate(experiment.cell_names())}
    threads = len(experiment.threads)
    names = set(columns(threads))

    def fault(row: Row) -> str | None:
        if set(row) != names:
            return "it has other columns than this version of the lab writes"
        if row["cell"] not in cells or row["experiment"] != experiment.name:
            return f"it is of {row['experiment']!r}, cell {row['cell']!r}"
        return record_fault(row, threads)

    def order(row: Row) -> tuple[int, int]:
        return cells.get(row["cell"], len(cells)), row["index"]

    hashes = {"spec": f"{experiment.name} {experiment.content_hash[:16]}"}
    return Owner(hashes, ("unit_id",), order, fault, _MEND)


def open_ledger(folder: Path, experiment: Experiment, read_only: bool = False) -> Ledger:
    """Open the ledger of an experiment; see :meth:`experiments.jobs.ledger.Ledger.open`."""
    return Ledger.open(folder, owner_of(experiment), read_only)


def read_experiment(folder: Path | str) -> "tuple[ExperimentSpec, pd.DataFrame]":
    """Read the spec of an experiment and the table of its units, also during a run.

    Args:
        folder: with a ledger, or with only the exported table.

    Returns:
        The spec, and one row per unit in the order of cells and index, with the columns of
        :func:`experiments.eq1.records.columns`: nullable boolean, Int64, Float64 and string.

    Raises:
        InputError: it is not an experiment's folder, or its rows are damaged.
    """
    spec, rows = read_rows(Path(folder))
    return spec, data_frame(rows, len(spec.threads))


def read_rows(folder: Path) -> "tuple[ExperimentSpec, list[dict[str, Any]]]":
    """Read the same as :func:`read_experiment`, the records as plain rows."""
    spec = read_spec(folder)
    if _is_exported(folder):
        return spec, read_table(folder / TABLE_FILE, spec, _spec_digest(folder))
    with open_ledger(folder, spec, read_only=True) as ledger:
        return spec, ledger.rows()


def read_errors(folder: Path) -> list[dict[str, Any]]:
    """Read the infrastructure errors of an experiment; none if they were not exported with its table.

    Raises:
        InputError: it is not an experiment's folder, or its rows are damaged.
    """
    if _is_exported(folder):
        return read_error_table(folder / ERRORS_FILE) if is_given(folder / ERRORS_FILE) else []
    with open_ledger(folder, read_spec(folder), read_only=True) as ledger:
        return ledger.errors()


def read_spec(folder: Path) -> "ExperimentSpec":
    """Read the spec of an experiment's folder.

    No unit is drawn: a table's rows can be read where the code at hand refuses the conditions of its spec.

    Raises:
        InputError: the folder has no spec.
    """
    from dslab.experiments.eq1.spec import read_spec_file, validated

    if not is_given(folder / SPEC_FILE):
        raise InputError(str(folder), f"has no {SPEC_FILE}", "give the folder of an experiment that was run")
    file = read_spec_file(folder / SPEC_FILE)
    return validated(file.data, file)


def release_of(folder: Path) -> str | None:
    """The release that replays an exported table; None for a ledger.

    Raises:
        InputError: it is no such table.
    """
    return table_release(folder / TABLE_FILE) if _is_exported(folder) else None


def claim_folder(folder: Path) -> None:
    """Create the folder of an experiment, or check that it is one.

    Raises:
        InputError: it holds other files or cannot be created.
    """
    own = {SPEC_FILE, LOCK_FILE, *(LEDGER_FILE + end for end in ("", "-wal", "-shm", "-journal"))}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Of a run that was killed while it wrote its spec.
        sweep(folder, f".{SPEC_FILE}.partial-")
        found = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise unwritable(folder, error) from error
    if found - own and LEDGER_FILE not in found:
        raise InputError(str(folder), "already holds files", "choose a new folder, or empty this one first")


def write_spec(folder: Path, experiment: Experiment) -> None:
    """Write the spec beside its ledger.

    Raises:
        InputError: it cannot be written.
    """
    write_file(folder / SPEC_FILE, partial(Path.write_text, data=experiment.as_yaml(), encoding="utf-8"))


def export(folder: Path, csv: bool = False) -> Path:
    """Write ``units.parquet``, one row per unit, and the infrastructure errors; returns its path.

    Columns, their types and the order of rows depend only on the spec.

    Args:
        folder: of an experiment that was run.
        csv: write ``units.csv`` too.

    Raises:
        InputError: it is not such a folder, or cannot be written.
    """
    spec = read_spec(folder)
    with open_ledger(folder, spec, read_only=True) as ledger:
        rows, errors = ledger.rows(), ledger.errors()
    about = {"spec": spec, "spec_digest": _spec_digest(folder)}
    write_file(folder / TABLE_FILE, partial(write_table, rows=rows, **about))
    write_file(folder / ERRORS_FILE, partial(write_errors, errors=errors))
    if csv:
        write_file(
            folder / "units.csv",
            partial(data_frame(rows, len(spec.threads)).to_csv, index=False, lineterminator="\n"),
        )
    return folder / TABLE_FILE


def _is_exported(folder: Path) -> bool:
    """True if the folder holds the exported table alone, without the ledger."""
    return not is_given(folder / LEDGER_FILE) and is_given(folder / TABLE_FILE)


def _spec_digest(folder: Path) -> str:
    return hashlib.sha256(read_bytes(folder / SPEC_FILE, SETTINGS_BYTES)).hexdigest()
