"""Eq. 1 recomputed from a table of units with pandas alone, to check `dslab experiment report` by.

Run: python examples/recompute.py docs/eq1/units.parquet
"""

import sys

import numpy as np
import pandas as pd
from scipy.stats import t as student

table = pd.read_parquet(sys.argv[1] if len(sys.argv) > 1 else "docs/eq1/units.parquet")
table = table[(table.outcome == "completed") & (table.kind != "sham")]
# Where its stress did not act, a unit is of another population than its cell.
table = table[table.exposed.ne(False)]
threads = sum(name.startswith("d") and name[1:].isdigit() for name in table)
failed = [f"cross_r{j}_failed" for j in range(1, threads + 1)]


def interval(by_world):
    """Wilson's interval of a share, with as many trials as the spread of the worlds' means is worth."""
    worlds, p, variance = len(by_world), by_world.mean(), by_world.var()
    trials = p * (1 - p) * worlds / variance if variance > 0 else worlds
    z2 = student.ppf(0.975, worlds - 1) ** 2
    middle, half = p + z2 / (2 * trials), np.sqrt(z2 * (p * (1 - p) / trials + z2 / (4 * trials**2)))
    return p, (middle - half) / (1 + z2 / trials), (middle + half) / (1 + z2 / trials)


def product_over_different_worlds(means):
    """Eq. 1: the mean over all choices of different worlds of p0 of one times pr1 of another and so on."""
    x = means.to_numpy(float)
    # Sum over the choices by which factors the worlds so far have given; each world gives one at most.
    sums = {frozenset(): 1.0}
    for world in x:
        grown = dict(sums)
        for given, value in sums.items():
            for factor in set(range(len(world))) - given:
                grown[given | {factor}] = grown.get(given | {factor}, 0.0) + value * world[factor]
        sums = grown
    return sums[frozenset(range(x.shape[1]))] / np.prod(len(x) - np.arange(x.shape[1]))


rows = []
for (cell, world), units in table.groupby(["cell", "world"], sort=False):
    # Equal weight per world, then sequence, then replicate.
    levels = ["world_seed", "sequence"]
    replicates = units.groupby(levels)["cell"].transform("size")
    for n in range(1, threads + 1):
        # A sequence counts if it has n + 1 completed replicates, or all that the design has.
        counted = units[replicates > min(n, replicates.max() - 1)]
        events = counted[["breakage", *failed[:n]]].astype(float)
        events["in_units"], events["measured"] = events.prod(axis=1), counted[f"d{n}"].astype(float)
        means = events.groupby([counted[name] for name in levels]).mean().groupby(level=0).mean()
        p0, low, high = interval(means["breakage"])
        measured, measured_low, measured_high = interval(means["measured"])
        rows.append(
            {
                "cell": cell, "world": world, "n": n, "worlds": len(means),
                "p0": p0, "p0_low": low, "p0_high": high,
                "eq1": product_over_different_worlds(means[["breakage", *failed[:n]]]),
                "weakest_link": means[["breakage", *failed[:n]]].mean().min(),
                "in_units": means["in_units"].mean(), "measured": measured,
                "measured_low": measured_low, "measured_high": measured_high,
            }
        )  # fmt: skip
found = pd.DataFrame(rows)
print(found.round(3).to_string(index=False))
