"""Renewal of a damaged ledger, which loses the damaged rows."""

import os
import shutil
from contextlib import closing
from pathlib import Path

from dslab.experiments.campaign.folder import SPEC_FILE
from dslab.experiments.campaign.ledger import LEDGER_FILE, Ledger
from dslab.experiments.campaign.ledger_file import connect, explained, has_tables
from dslab.experiments.campaign.schedule import Experiment
from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import unwritable

_RENEWED = ".ledger-renewed"


def renew_ledger(folder: Path, experiment: Experiment, drop_damaged: bool = False) -> None:
    """Write a damaged ledger anew without its damaged rows, if that is wanted.

    The ledger is replaced when the new one is whole. Only the driver of the folder may call this.

    Args:
        folder: of the experiment.
        experiment: its spec.
        drop_damaged: leave out rows that are damaged or cannot be read, so that their units are run again.

    Raises:
        InputError: the ledger is damaged and this is not to be mended, or cannot be; it has been emptied; or
            the disk is full.
    """
    path, renewed = folder / LEDGER_FILE, folder / _RENEWED
    shutil.rmtree(renewed, ignore_errors=True)
    if not path.is_file():
        return
    # SQLite removes its log with the last connection that may write; it would apply one to the new file.
    with explained(path), closing(connect(path, "rw")) as connection:
        if not has_tables(connection):
            if (folder / SPEC_FILE).is_file():  # written after the tables
                remedy = "put a copy back, or remove it to run all units again"
                raise InputError(str(path), "is empty: its rows are lost", remedy)
            return
        with Ledger.open(folder, experiment, read_only=True) as old:
            if not drop_damaged:
                return
            units, errors = old.sound_rows("units"), old.sound_rows("infrastructure_errors")
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    try:
        renewed.mkdir()
        with Ledger.open(renewed, experiment) as new:
            new.add_rows("units", units)
            new.add_rows("infrastructure_errors", errors)
        os.replace(renewed / LEDGER_FILE, path)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        shutil.rmtree(renewed, ignore_errors=True)
