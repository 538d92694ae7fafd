"""Rows of a long measurement, kept in a Parquet file so that it can be stopped and resumed."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd

from dslab.scenarios.errors import InputError

Row = dict[str, Any]


def read_rows(table: Path, of: str, code: str) -> list[Row]:
    """Read the rows of an unfinished measurement; none if there is no file.

    Args:
        table: the file.
        of: what the rows are of, for messages.
        code: hash of the present code, which every row must be of, in its column ``code``.

    Raises:
        InputError: the file is no such table, or is of other code.
    """
    if not table.exists():
        return []
    try:
        rows = pd.read_parquet(table).to_dict("records")
        others = {row["code"] for row in rows} - {code}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(str(table), f"is no table of {of}: {error}", "name another file") from None
    if others:
        raise InputError(str(table), "has rows of other code", "name another file, or remove this one")
    return [{str(name): value for name, value in row.items()} for row in rows]


def extend_rows(
    rows: list[Row],
    table: Path,
    key: Sequence[str],
    jobs: Sequence[tuple],
    work: Callable[..., list[Row]],
    workers: int,
    progress: Callable[[str, int, int], None] | None,
    n_done: int = 0,
) -> list[Row]:
    """Run jobs in processes and write all rows after each.

    Args:
        rows: those that there are.
        table: the file.
        key: columns by which rows are sorted.
        jobs: arguments of ``work``, one tuple per sequence.
        work: makes the rows of a job; a function of a module.
        workers: number of processes.
        progress: called with (step, sequences done, sequences in all).
        n_done: sequences that need no job.

    Returns:
        All rows.
    """
    rows = list(rows)
    # "spawn": a fork would share the OpenGL context.
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        running = [pool.submit(work, *job) for job in jobs]
        try:
            for number, future in enumerate(as_completed(running), start=n_done + 1):
                rows += future.result()
                write_rows(table, rows, key)
                if progress is not None:
                    progress("sequences", number, n_done + len(jobs))
        finally:
            pool.shutdown(cancel_futures=True)
    return rows


def write_rows(table: Path, rows: list[Row], key: Sequence[str]) -> None:
    """Write the file anew, sorted by the columns ``key``; it is never half-written."""
    table.parent.mkdir(parents=True, exist_ok=True)
    unfinished = table.with_name(f".{table.name}.{os.getpid()}")
    try:
        pd.DataFrame(rows).sort_values(list(key)).to_parquet(unfinished, index=False)
        unfinished.replace(table)
    finally:
        unfinished.unlink(missing_ok=True)
