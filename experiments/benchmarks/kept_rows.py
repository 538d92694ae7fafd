"""Rows of a long measurement, kept in a folder's ledger so that it can be stopped and resumed."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from dslab.experiments.jobs.ledger import Owner, Row, ledger_of
from dslab.experiments.jobs.pool import run_each
from dslab.experiments.runs.files import plain
from dslab.experiments.runs.provenance import code_hash, commit
from dslab.sim.io.folders import write_file

ROWS_FILE = "rows.parquet"


def keep_rows(
    folder: Path,
    of: str,
    key: tuple[str, ...],
    jobs: Mapping[tuple, Any],
    work: Callable[[Any], list[Row]],
    workers: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> pd.DataFrame:
    """Run the jobs of which a folder has no row yet; returns the rows of all, sorted by ``key``.

    Args:
        folder: of the ledger, absent or that of an earlier measurement by the same code; gets rows.parquet.
        of: what is measured, for messages.
        key: columns that tell a row from the others.
        jobs: by the first columns of ``key``: their rows are known to be there or not.
        work: makes the rows of a job; a function of a module.
        workers: number of processes; None for this one.
        progress: called with (step, jobs done, jobs in all).

    Raises:
        InputError: the folder is of other code, of something else, in use, or cannot be written.
    """
    about = {"code": code_hash(), "commit": commit()}
    owner = Owner({"measurement": of, "version of the code": about["code"]}, key)
    width = len(next(iter(jobs), ()))
    with ledger_of(folder, owner) as ledger:
        done = {tuple(row[name] for name in key[:width]) for row in ledger.rows()}
        missing = [job for of, job in jobs.items() if of not in done]
        each = ((job, work(job)) for job in missing) if workers is None else run_each(work, missing, workers)
        for number, (_, rows) in enumerate(each, 1 + len(jobs) - len(missing)):
            ledger.add(*(plain(row | about) for row in rows))
            if progress is not None:
                progress("sequences", number, len(jobs))
        rows = [row for row in ledger.rows() if tuple(row[name] for name in key[:width]) in jobs]
    frame = pd.DataFrame(rows).sort_values(list(key)).reset_index(drop=True)
    write_file(folder / ROWS_FILE, lambda path: frame.to_parquet(path, index=False))
    return frame
