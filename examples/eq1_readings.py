"""What the report of an experiment on Eq. 1 leaves out, as it takes minutes.

Run: python examples/eq1_readings.py [FOLDER] [PART ...], with docs/eq1 and all parts by default:

- trials: shares of all trials, which weigh conditions by their worlds, and chance by condition;
- void: verdicts that change if worlds with a void trial leave every condition;
- way: k of Q and D in every test, 0 for Eq. 1 and 1 for the weakest link;
- beta: the beta factor's beta of each condition;
- difficulties: the correlation of the difficulties of two events in each condition;
- transfer: errors of the formulas in conditions, and kinds of stress, that they were not fitted to;
- exchange: how often the test within sequences sees runs that decide all by one draw;
- words: verdicts on the very tests if Eq. 1 is true.
"""

import sys
from itertools import combinations
from pathlib import Path

import numpy as np

from dslab.experiments.campaign.folder import read_experiment
from dslab.experiments.report.content import PAPER_THREAD
from dslab.experiments.statistics.analysis import analyse
from dslab.experiments.statistics.difficulties import Counts, correlation_of
from dslab.experiments.statistics.estimates import Figure, measured_in_units
from dslab.experiments.statistics.from_records import cells_of
from dslab.experiments.statistics.judged import judge_cells, share_of_chance
from dslab.experiments.statistics.outcomes import world_means
from dslab.experiments.statistics.rehearsal import exchange_power, rehearse_words
from dslab.experiments.statistics.transfer import Condition, beta_of, transfer
from dslab.experiments.statistics.verdicts import Verdict, compare_forecast
from dslab.experiments.statistics.world_intervals import ratio_interval, way_interval

EXPERIMENTS = 400
folder, *parts = sys.argv[1:] or ["docs/eq1"]
spec, table = read_experiment(Path(folder))
threads, tested = len(spec.threads), spec.confirmatory_threads or len(spec.threads)
names = ["B", *("paper" if thread.kind == PAPER_THREAD else thread.kind for thread in spec.threads)]
cells = [cell for cell in cells_of(table, threads) if cell.units]


def show(interval, scale=1.0):
    if interval is None:
        return "-"
    value, low, high = (scale * end for end in (interval.value, interval.low, interval.high))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def trials():
    """Sums over the conditions of each world, as a ratio with its interval."""
    parts = {f"D, {n} threads": lambda c, n=n: c.outcomes.dual_failures[n - 1] for n in range(1, threads + 1)}
    parts["D, what the second thread takes off"] = lambda c: -np.diff(c.outcomes.dual_failures, axis=0)[0]
    parts["mission failures, two threads"] = lambda c: c.events("m2")
    parts["mission failures of the base"] = lambda c: c.events("base_mission_failure")
    parts["breakages"] = lambda c: c.outcomes.breakage
    parts["relocalized"] = lambda c: c.events("relocalized")
    parts["hopeless breakages"] = lambda c: c.outcomes.breakage * (c.values("rescuable") == 0)
    for what, of in parts.items():
        sums = {}
        for cell in cells:
            for seed, mean in zip(cell.worlds, world_means(of(cell)), strict=True):
                if np.isfinite(mean):
                    sums.setdefault((cell.world, seed), []).append(mean)
        numerator, number = (
            Figure.mean(np.array([f(own) for own in sums.values()], float)) for f in (sum, len)
        )
        units = int(sum(np.nansum(of(cell)) for cell in cells))
        print(f"{what:38} {show(ratio_interval(numerator, number), 100)} % of all trials, {units}")
    for cell in cells:
        print(f"{cell.name:26} chance {show(share_of_chance([cell]))}")


def void():
    lost = table[table["outcome"] == "void"][["world", "world_seed"]].drop_duplicates()
    of_kind = (
        table.merge(lost, on=["world", "world_seed"], indicator=True, how="left")["_merge"] == "left_only"
    )
    kept = {"of their kind": of_kind.to_numpy(), "of all": ~table["world_seed"].isin(lost["world_seed"])}
    before = verdicts_of(table)
    for what, rows in kept.items():
        after = verdicts_of(table[np.asarray(rows, bool)])
        changed = sum(after[test] != verdict for test, verdict in before.items())
        print(f"{len(lost)} worlds leave all conditions {what}: {changed} of {len(before)} verdicts change")


def verdicts_of(rows):
    found = analyse(rows, threads, spec.confirmatory, confirmatory_threads=tested).cells
    return {(c.cell, c.n): (c.verdict_in_units, c.verdict_forecast) for c in found if c.n <= tested}


def way():
    for n in range(1, tested + 1):
        for cell in cells:
            outcomes = cell.usable(n)
            forecast = compare_forecast(outcomes)
            both = (measured_in_units(outcomes), forecast.measured)
            q, d = (way_interval(measured, forecast.product, forecast.weakest) for measured in both)
            print(f"{n} {cell.name:26} k of Q {show(q):22} of D {show(d)}")


def beta():
    for n in range(1, threads + 1):
        print(n, "; ".join(f"{cell.name} {show(beta_of(cell.usable(n)))}" for cell in cells))


def difficulties():
    for cell in cells:
        counts = Counts.of(cell.outcomes.columns)
        for first, second in combinations(range(threads + 1), 2):
            found = correlation_of(counts.only(first, second))
            print(f"{cell.name:26} {names[first]:6} {names[second]:6} {show(found)}", flush=True)


def conditions(n, group):
    judged = judge_cells(cells, n, spec.confirmatory, np.random.default_rng(0), 999, tested)
    of = {cell.cell: cell for cell in judged if cell.n == n}
    for cell in cells:
        fitted = of[cell.name].verdict_in_units != Verdict.UNTESTED and not of[cell.name].saturated
        yield Condition(cell.usable(n), getattr(cell, group), fitted)


def transfers():
    for group, what in (("name", "each condition left out"), ("kind", "each kind of stress left out")):
        for n in range(1, threads + 1):
            print(
                f"{what}, n = {n}: error of D in points, gain over Eq. 1 in 1000 log loss, errors, parameters"
            )
            scores = transfer(list(conditions(n, group)))
            for score in scores:
                error, gain = 100 * np.mean(np.abs(score.errors)), show(score.gain_over(scores[0]), 1000)
                each = " ".join(f"{100 * e:+.1f}" for e in score.errors)
                fitted = "" if score.parameters is None else np.round(score.parameters, 2)
                print(f"  {score.name:24} {error:4.1f}  {gain:24} {each}  {fitted}")
            over = show(scores[4].gain_over(scores[2]), 1000)
            print(f"  {scores[4].name} over {scores[2].name}: {over}")


def exchange():
    for n in range(1, tested + 1):
        each = [cell.outcomes.of_first(n) for cell in cells]
        for shared in (0.0, 0.1, 0.25, 0.5):
            found = exchange_power(each, shared, np.random.default_rng(n), EXPERIMENTS)
            print(
                f"{n}: {shared:.0%} of runs with one draw: power {found.power:.3f} +- {found.error:.3f}, "
                f"{found.telling:.0f} telling sequences",
                flush=True,
            )


def words():
    tests = [(cell, n) for n in range(1, tested + 1) for cell in cells]
    outcomes = [(cell.outcomes, n) for cell, n in tests]
    for (cell, n), found in zip(
        tests, rehearse_words(outcomes, np.random.default_rng(0), EXPERIMENTS), strict=True
    ):
        print(f"{n} {cell.name:26} Q {found.on_units}  D {found.on_dual_failures}")


ALL = {
    "trials": trials,
    "void": void,
    "way": way,
    "beta": beta,
    "difficulties": difficulties,
    "transfer": transfers,
    "exchange": exchange,
    "words": words,
}
for part in parts or ALL:
    print(f"== {part}")
    ALL[part]()
