"""Levenberg-Marquardt: the one driver of the lab's least-squares problems.

A problem is a tuple of arrays, among them its state, with three functions. The driver is compiled into the
kernel that calls it with them; ``minimise.py_func`` drives those that are not compiled.

Source: Levenberg, "A method for the solution of certain non-linear problems in least squares", 1944;
Marquardt, 1963; Nielsen, "Damping Parameter in Marquardt's Method", 1999.
"""

import numpy as np
from numba import njit

from dslab.slam.optimization._cholesky import factor, solve

_LEAST_DAMPING = 1e-10
_NEXT_TO_NOTHING = 1e-9
"""Share of the cost: where a model predicts less of a gain, a rise means that the minimum is reached."""


@njit(inline="always")
def minimise(linearise, propose, accept, problem, cost, steps, damping, tolerance):
    """Lower the cost of a problem's state, in place; no step that raises it is kept.

    Args:
        linearise: ``(problem)``, writes the model of Gauss and Newton about the state.
        propose: ``(problem, damping)``, writes a trial state; its cost, infinite where there is none, and
            the gain that the model predicts.
        accept: ``(problem)``, makes the trial state the state; true if that ends the search.
        problem: see above.
        cost: of its state.
        steps: most that are tried.
        damping: of the first.
        tolerance: gain over the cost up to which the search has converged.

    Returns:
        Final cost, and number of steps that were kept.
    """
    growth, fresh, kept = 2.0, False, 0
    for _ in range(steps):
        if not fresh:
            linearise(problem)
            fresh = True
        trial_cost, predicted = propose(problem, damping)
        gain = cost - trial_cost
        if gain >= 0.0:
            arrived = accept(problem)
            kept += 1
            fresh = False
            converged = arrived or gain <= tolerance * cost
            cost = trial_cost
            if converged:
                break
            ratio = min(gain / max(predicted, 1e-300), 2.0)
            damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), _LEAST_DAMPING)
            growth = 2.0
        else:
            if predicted <= _NEXT_TO_NOTHING * cost:
                break
            damping *= growth
            growth *= 2.0
    return cost, kept


@njit(cache=True, nogil=True)
def damped_step(H, gradient, damping, L, rows, step):
    """Solve ``(H + damping diag(H)) step = -gradient``; the gain that is predicted, infinite without one.

    Args:
        H: (n, n), of which the lower triangle is read.
        gradient: (n,), both of half the cost.
        damping: see there.
        L: (n, n) room.
        rows: of ``whole_rows(n)``.
        step: (n,), written.
    """
    n = len(gradient)
    floor = 1e-12 * (1.0 + np.trace(H))
    for i in range(n):
        for j in range(i + 1):
            L[i, j] = H[i, j]
        L[i, i] += damping * H[i, i] + floor
        step[i] = -gradient[i]
    if not factor(L, rows):
        return np.inf
    solve(L, rows, step)
    predicted = 0.0
    for i in range(n):
        predicted += step[i] * (damping * H[i, i] * step[i] - gradient[i])
    return predicted


# A problem of few unknowns is (state, trial state, what is observed, H, gradient, H and gradient about the
# trial state, and the other arguments of ``damped_step``): each cost comes with the model about its state.


@njit(inline="always")
def is_known(problem):
    """The model about the state is that about the last trial state, which was accepted."""


@njit(inline="always")
def accept_trial(problem):
    """Make the trial state the state of a problem of few unknowns, and its model the model."""
    state, trial, _, H, gradient, trial_H, trial_gradient, _, _, _ = problem
    state[:], H[:], gradient[:] = trial, trial_H, trial_gradient
    return False
