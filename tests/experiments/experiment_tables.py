"""Synthetic tables of records from known models of failure, for the tests of the statistics."""

import numpy as np
import pandas as pd

from experiments.eq1.records import columns, dual_column, thread_column

_DTYPES = {"bool": "boolean", "int": "Int64", "float": "Float64", "text": "string"}


def simulated_cell(
    rng, cell, severity, units, p0, pr, threads=2, shared=0.0, units_per_world=1, crossing=True
):
    """A cell in which each failure has its own probability, and a difficulty common to a unit's failures.

    `shared` is the standard deviation of the common difficulty, on the logit scale; 0 makes all outcomes
    independent, hence Eq. 1 true.
    """
    difficulty = rng.normal(size=units) * shared

    def fails(p):
        return rng.random(units) < 1 / (1 + np.exp(-(np.log(p / (1 - p)) + difficulty)))

    breakage = fails(p0)
    found = {
        "unit_id": [f"{cell}-{i}" for i in range(units)],
        "cell": [cell] * units,
        "kind": [cell.split("/")[0]] * units,
        "severity": [float(severity)] * units,
        "world_seed": np.arange(units) // units_per_world,
        "outcome": ["completed"] * units,
        "breakage": breakage,
        "base_failure": breakage,
        "silent_failure": [False] * units,
        "reinit": np.where(breakage, True, None),
        "free_frames_to_cross": np.where(breakage, 60, None),
        "cross_reinit": [True] * units,
        "cross_frames_to_cross": [100] * units,
    }
    failed = breakage
    for thread in range(1, threads + 1):
        free, cross = fails(pr), fails(pr)
        failed = failed & free
        found[thread_column("free", thread, "failed")] = np.where(breakage, free, None)
        if crossing:
            found[thread_column("cross", thread, "failed")] = cross
            found[thread_column("cross", thread, "declared")] = ~cross
            found[thread_column("cross", thread, "false")] = np.where(cross, None, False)
            found[thread_column("cross", thread, "stage")] = np.where(cross, "sim3", None)
        found[dual_column(thread)] = failed
    wanted = columns(threads)
    table = pd.DataFrame(found).reindex(columns=list(wanted))
    return table.astype({name: _DTYPES[kind] for name, kind in wanted.items()})


def within_monte_carlo(share, wanted, replicates, errors=3.5):
    """True if a simulated share agrees with a wanted one."""
    return abs(share - wanted) <= errors * np.sqrt(wanted * (1 - wanted) / replicates)


def at_most(share, wanted, replicates, errors=3.0):
    """True if a simulated share exceeds a wanted one only by chance."""
    return share <= wanted + errors * np.sqrt(wanted * (1 - wanted) / replicates)
