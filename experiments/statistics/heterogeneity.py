"""Models of uneven difficulty: failures coincide although they are independent at each difficulty."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.special import betaln, psi, xlog1py, xlogy
from scipy.stats import chi2

from experiments.statistics.eq1 import posterior_draws
from experiments.statistics.intervals import clopper_pearson
from experiments.statistics.joint import DUAL_FAILURE, NO_BREAKAGE, Floats, JointCounts
from experiments.statistics.results import BetaBinomial, BetaFactor, EckhardtLee, Estimate, Mixture

_LARGEST_PRECISION = 1e5
_SWEEPS = 300


def eckhardt_lee(
    cells: Sequence[JointCounts], draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> EckhardtLee | None:
    """Eq. 1 averaged over cells, against Eq. 1 of the averages, cells weighted by their units.

    The first is at least the second if p0 and pr rise together: a benchmark that pools easy and hard
    sequences refutes Eq. 1 even if it holds in each of them.

    Args:
        cells: counts of the cells at one n.
        draws: from the posterior.
        rng: of the draws.
        confidence: of the intervals.

    Returns:
        None if no cell has a unit.

    Source: Eckhardt & Lee, IEEE Trans. Software Engineering 1985.
    """
    cells = [c for c in cells if c.table.sum()]
    if not cells:
        return None
    units = np.array([c.table.sum() for c in cells], float)
    weights = units / units.sum()
    found = [c.margins for c in cells]
    p0 = np.array([m.breakages[0] for m in found]) / units
    pr = np.array([m.crossings[0] for m in found]) / units[:, None]
    ends = []
    for state, failed, tail in (
        (NO_BREAKAGE, False, (1 - confidence) / 2),
        (DUAL_FAILURE, True, (1 + confidence) / 2),
    ):
        drawn = [posterior_draws(c, state, failed, draws, rng) for c in cells]
        p0_drawn, pr_drawn = (np.stack([getattr(d, name) for d in drawn], axis=1) for name in ("p0", "pr"))
        ends.append([np.quantile(x, tail) for x in _averaged(p0_drawn, pr_drawn, weights)])
    values = _averaged(p0[None], pr[None], weights)
    within, pooled = (
        Estimate(float(value[0]), float(low), float(high), method)
        for value, low, high, method in zip(
            values, *ends, ("E[p0 · Π pr_j]", "E[p0] · Π E[pr_j]"), strict=True
        )
    )
    failures = int(sum(m.failures[0] for m in found))
    return EckhardtLee(
        cells[0].threads,
        within,
        pooled,
        clopper_pearson(failures, int(units.sum()), confidence),
    )


def _averaged(p0: Floats, pr: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Mean of the cells' products, and product of their means: (D, C) p0, (D, C, n) pr, (C,) weights."""
    within = (p0 * pr.prod(axis=2)) @ weights
    pooled = (p0 @ weights) * np.einsum("dcj,c->dj", pr, weights).prod(axis=1)
    return within, pooled


def beta_binomial(quantity: str, events: Floats, units: Floats) -> BetaBinomial:
    """Fit θ ~ Beta to the counts of groups that each have their own θ.

    Args:
        quantity: name of the count, copied to the result.
        events, units: (G,) per group; groups without units are ignored.
    """
    events, units = np.asarray(events, float), np.asarray(units, float)
    events, units = events[units > 0], units[units > 0]
    if units.size == 0:
        return BetaBinomial(quantity, None, None, None, None, None)
    mean = float(events.sum() / units.sum())
    if mean in (0.0, 1.0) or units.size < 2:
        return BetaBinomial(quantity, None, None, mean, None, None)

    start = np.log(mean / (1 - mean))
    bounds = [(start - 8, start + 8), (np.log(1e-3), np.log(_LARGEST_PRECISION))]
    fits = [
        minimize(_beta_binomial_loss, [start, s], (events, units), "SLSQP", jac=True, bounds=bounds)
        for s in (0.0, 3.0)
    ]
    best = min(fits, key=lambda fit: fit.fun)
    binomial = float(np.sum(xlogy(events, mean) + xlog1py(units - events, -mean)))
    gain = 2 * (-best.fun - binomial)
    if gain <= 1e-6:
        return BetaBinomial(quantity, None, None, mean, 0.0, 1.0)
    centre, precision = 1 / (1 + np.exp(-best.x[0])), np.exp(best.x[1])
    spread = (1 - centre) / (centre * (precision + 1))
    p = float(chi2.sf(gain, 1) / 2)
    return BetaBinomial(
        quantity, float(centre * precision), float((1 - centre) * precision), float(centre), float(spread), p
    )


def _beta_binomial_loss(parameters: Floats, events: Floats, units: Floats) -> tuple[float, Floats]:
    """Negative log likelihood and its gradient by (logit of the mean, log of alpha + beta)."""
    centre, precision = 1 / (1 + np.exp(-parameters[0])), np.exp(parameters[1])
    a, b = centre * precision, (1 - centre) * precision
    value = np.sum(betaln(a + events, b + units - events) - betaln(a, b))
    common = psi(precision) - psi(precision + units)
    by_a = np.sum(psi(a + events) - psi(a) + common)
    by_b = np.sum(psi(b + units - events) - psi(b) + common)
    gradient = np.array([centre * (1 - centre) * precision * (by_a - by_b), a * by_a + b * by_b])
    return -float(value), -gradient


def beta_factor(cells: Mapping[str, JointCounts], confidence: float = 0.95) -> BetaFactor | None:
    """Fit the share β of failures with a cause common to all channels, one for all cells.

    The cells' p0 and pr_j are taken as measured, and the interval is the likelihood's given them.

    Returns:
        None if no cell has a breakage.

    Source: Fleming, "A reliability model for common mode failures", 1975.
    """
    found = {name: c.margins for name, c in cells.items() if c.table.sum()}
    if not any(m.breakages[0] for m in found.values()):
        return None
    units = np.array([m.units[0] for m in found.values()])
    failures = np.array([m.failures[0] for m in found.values()])
    single = np.array([[m.breakages[0], *m.crossings[0]] for m in found.values()]) / units[:, None]
    threads = single.shape[1] - 1

    def predicted(beta: float) -> Floats:
        return beta * single.min(axis=1) + (1 - beta) ** (threads + 1) * single.prod(axis=1)

    def likelihood(beta: float) -> float:
        p = np.clip(predicted(beta), 1e-12, 1 - 1e-12)
        return float(np.sum(xlogy(failures, p) + xlog1py(units - failures, -p)))

    grid = np.linspace(0, 1, 201)
    near = grid[int(np.argmax([likelihood(b) for b in grid]))]
    inside = minimize_scalar(
        lambda b: -likelihood(b), bounds=(max(near - 0.005, 0), min(near + 0.005, 1)), method="bounded"
    ).x
    best = max((float(near), float(inside)), key=likelihood)
    floor = likelihood(best) - chi2.ppf(confidence, 1) / 2
    low = brentq(lambda b: likelihood(b) - floor, 0, best) if best > 0 and likelihood(0) < floor else 0.0
    high = brentq(lambda b: likelihood(b) - floor, best, 1) if best < 1 and likelihood(1) < floor else 1.0
    names = dict(zip(found, map(float, predicted(best)), strict=True))
    estimate = Estimate(
        best, float(low), float(high), "common-cause share; interval of the profile likelihood"
    )
    return BetaFactor(threads, estimate, names)


def mixture(
    failed_threads: Sequence[int],
    threads: int,
    draws: int,
    rng: np.random.Generator,
    confidence: float = 0.95,
) -> Mixture | None:
    """Fit two classes: hopeless breakages, and the rest, where threads fail independently and alike.

    Args:
        failed_threads: number of failed threads per breakage, all having been run.
        threads: n; the classes cannot be separated with fewer than two.
        draws: from the posterior of the counts, for the intervals.
        rng: of the draws.
        confidence: of the intervals.
    """
    counts = np.bincount(np.asarray(failed_threads, int), minlength=threads + 1).astype(float)
    if threads < 2 or counts.sum() == 0:
        return None
    method = "two-class mixture; interval of posterior draws"
    if counts[:-1].sum() == 0:  # every thread failed every time: the rest may be empty, or fail always
        none = Estimate.undetermined(method)
        return Mixture(int(counts.sum()), none, none)
    best = _mixture_fit(counts[None])
    drawn = _mixture_fit(rng.dirichlet(counts + 0.5, draws) * counts.sum())
    return Mixture(
        int(counts.sum()),
        _share(float(best[0][0]), drawn[0], confidence, method),
        _share(float(best[1][0]), drawn[1], confidence, method),
    )


def _share(value: float, drawn: Floats, confidence: float, method: str) -> Estimate:
    """A share and its interval, which ends at 0 or 1 where the share is on that border.

    Source: Brown, Cai & DasGupta, "Interval estimation for a binomial proportion", Statistical Science 2001.
    """
    low, high = np.quantile(drawn, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Estimate(value, float(low) if low <= value else 0.0, float(high) if value <= high else 1.0, method)


def _mixture_fit(counts: Floats) -> tuple[Floats, Floats]:
    """Expectation-maximisation on (M, n + 1) counts of breakages by failed threads."""
    threads = counts.shape[1] - 1
    total, failures = counts.sum(axis=1), counts @ np.arange(threads + 1)
    hopeless, pr = counts[:, -1] / total / 2, np.clip(failures / total / threads, 1e-9, 1 - 1e-9)
    for _ in range(_SWEEPS):
        rest = (1 - hopeless) * pr**threads
        belief = np.divide(hopeless, hopeless + rest, out=np.zeros_like(rest), where=hopeless + rest > 0)
        certain = counts[:, -1] * belief
        hopeless = certain / total
        pr = np.clip((failures - threads * certain) / np.maximum((total - certain) * threads, 1e-12), 0, 1)
    return hopeless, pr
