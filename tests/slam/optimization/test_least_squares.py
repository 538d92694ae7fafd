"""The driver of least squares: it descends, only descends, and knows when it is done."""

import numpy as np
import pytest

from dslab.slam.optimization.least_squares import minimise


class Valley:
    """Rosenbrock's curved valley, as squares of two residuals; what was asked of it is noted."""

    def __init__(self, start=(-1.2, 1.0), solvable=True):
        self.x = np.array(start)
        self.solvable = solvable
        self.costs, self.dampings, self.models = [self.cost(self.x)], [], 0

    @staticmethod
    def cost(x):
        return float((10 * (x[1] - x[0] ** 2)) ** 2 + (1 - x[0]) ** 2)

    def linearise(self):
        self.models += 1
        J = np.array([[-20 * self.x[0], 10.0], [-1.0, 0.0]])
        r = np.array([10 * (self.x[1] - self.x[0] ** 2), 1 - self.x[0]])
        self.H, self.g = J.T @ J, J.T @ r

    def propose(self, damping):
        self.dampings.append(damping)
        if not self.solvable:
            return np.inf, np.inf
        d = damping * np.diag(self.H)
        step = np.linalg.solve(self.H + np.diag(d), -self.g)
        self.trial = self.x + step
        return self.cost(self.trial), float(step @ (d * step - self.g))

    def accept(self):
        self.x = self.trial
        self.costs.append(self.cost(self.x))

    def minimised(self, steps=100, tolerance=1e-12):
        functions = Valley.linearise, Valley.propose, Valley.accept
        return minimise.py_func(*functions, self, self.costs[0], steps, 1e-3, tolerance)


def test_a_curved_valley_is_descended_to_its_end():
    valley = Valley()
    cost, kept = valley.minimised()
    np.testing.assert_allclose(valley.x, [1, 1], atol=1e-6)
    assert cost == valley.costs[-1] < 1e-12 and kept == len(valley.costs) - 1 == valley.models
    assert (np.diff(valley.costs) <= 0).all() and len(valley.dampings) > kept  # some step was undone


def test_a_rise_where_no_gain_is_predicted_ends_the_search():
    valley = Valley(start=(1.0, 1.0))
    valley.propose = lambda damping: (valley.dampings.append(damping), (2.0, 1e-30))[1]
    assert minimise.py_func(
        Valley.linearise, lambda v, d: v.propose(d), Valley.accept, valley, 1.0, 100, 1e-3, 1e-12
    ) == (1.0, 0)
    assert len(valley.dampings) == 1


@pytest.mark.parametrize("steps", [1, 6])
def test_without_a_solution_the_damping_grows_ever_faster(steps):
    valley = Valley(solvable=False)
    assert valley.minimised(steps) == (valley.costs[0], 0)
    factors = np.array(valley.dampings)[1:] / valley.dampings[:-1]
    assert valley.models == 1 and factors.tolist() == pytest.approx([2.0**k for k in range(1, steps)])
