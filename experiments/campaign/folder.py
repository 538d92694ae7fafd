"""The folder of an experiment: ``spec.yaml``, ``ledger.sqlite`` and, once exported, ``units.parquet``."""

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from experiments.campaign.folder_lock import LOCK_FILE
from experiments.campaign.ledger import ERROR_COLUMNS, LEDGER_FILE, Ledger
from experiments.campaign.schedule import Experiment
from experiments.eq1.record_table import arrow_table, typed
from scenarios.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from experiments.eq1.spec import ExperimentSpec

SPEC_FILE = "spec.yaml"
TABLE_FILE = "units.parquet"
ERRORS_FILE = "infrastructure_errors.parquet"


def read_experiment(folder: Path) -> "tuple[ExperimentSpec, pd.DataFrame]":
    """The spec of an experiment and the table of its units, also while it is being run.

    Args:
        folder: with a ledger, or with the exported table alone.

    Returns:
        The spec, and one row per unit in the order of cells and index, with the columns of
        :func:`experiments.eq1.records.columns`: nullable boolean, Int64, Float64 and string.

    Raises:
        InputError: it is no folder of an experiment, or its table has other columns.
    """
    spec = read_spec(folder)
    if not (folder / LEDGER_FILE).is_file() and (folder / TABLE_FILE).is_file():
        import pandas as pd

        try:
            return spec, typed(pd.read_parquet(folder / TABLE_FILE), len(spec.threads))
        except ValueError as error:
            remedy = "export it anew from its ledger, by the version that wrote it"
            raise InputError(str(folder / TABLE_FILE), str(error), remedy) from None
    with Ledger.open(folder, spec, read_only=True) as ledger:
        return spec, ledger.records()


def read_spec(folder: Path) -> "ExperimentSpec":
    """The spec of an experiment's folder.

    Raises:
        InputError: there is none.
    """
    from experiments.eq1.spec import load_spec

    if not (folder / SPEC_FILE).is_file():
        raise InputError(str(folder), f"has no {SPEC_FILE}", "give the folder of an experiment that was run")
    return load_spec(folder / SPEC_FILE)


def claim_folder(folder: Path) -> None:
    """Make the folder of an experiment, or make sure that it is one.

    Raises:
        InputError: it holds something else or cannot be made.
    """
    ends = ("", "-wal", "-shm", "-journal")
    own = {SPEC_FILE, *(name + end for name in (LOCK_FILE, LEDGER_FILE) for end in ends)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        found = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise _not_writable(folder, error) from error
    if found - own and LEDGER_FILE not in found:
        raise InputError(str(folder), "already holds files", "choose a new folder, or empty this one first")


def write_spec(folder: Path, experiment: Experiment) -> None:
    """Write the spec beside the ledger that has been found to be of it.

    Raises:
        InputError: it cannot be written.
    """
    text = experiment.as_yaml()
    try:
        _write(folder / SPEC_FILE, lambda path: path.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise _not_writable(folder, error) from error


def export(folder: Path, csv: bool = False) -> Path:
    """Write ``units.parquet``, one row per unit, and beside it the infrastructure errors; returns its path.

    Columns, their types and the order of rows depend on the spec alone.

    Args:
        folder: of an experiment that was run.
        csv: write ``units.csv`` too.

    Raises:
        InputError: it is no such folder, or cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    spec = read_spec(folder)
    with Ledger.open(folder, spec, read_only=True) as ledger:
        rows, errors = ledger.rows(), ledger.errors()
        records = ledger.records()
    about = {"experiment": spec.name, "spec_hash": spec.content_hash}
    table = arrow_table(rows, len(spec.threads)).replace_schema_metadata(about)
    whole = {"index", "attempt"}
    schema = pa.schema([(name, pa.int64() if name in whole else pa.string()) for name in ERROR_COLUMNS])
    try:
        _write(folder / TABLE_FILE, lambda path: pq.write_table(table, path))
        _write(
            folder / ERRORS_FILE,
            lambda path: pq.write_table(pa.Table.from_pylist(errors, schema=schema), path),
        )
        if csv:
            _write(folder / "units.csv", lambda path: records.to_csv(path, index=False, lineterminator="\n"))
    except OSError as error:
        raise _not_writable(folder, error) from error
    return folder / TABLE_FILE


def _write(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file beside its place and put it there when it is whole."""
    partial = path.with_name(f".{path.name}.partial-{uuid4().hex[:8]}")
    try:
        write(partial)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _not_writable(folder: Path, error: OSError) -> InputError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return InputError(str(folder), "the disk is full", "free some space and run the same command again")
    return InputError(
        str(folder), f"cannot be written ({error.strerror})", "choose a folder you may write to"
    )
