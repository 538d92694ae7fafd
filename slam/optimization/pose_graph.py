"""Pose-graph optimisation over Sim(3): distributes a loop's correction over the keyframes.

Source: Strasdat, Montiel, Davison, Scale Drift-Aware Large Scale Monocular SLAM, 2010, Sec. IV-C.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, identity
from scipy.sparse.linalg import splu

from dslab.slam.optimization.least_squares import minimise
from dslab.slam.optimization.sim3_algebra import (
    adjoint_sim3,
    exp_sim3,
    inverse_jacobians,
    invert_sim3,
    log_sim3,
)

_DIM = 7


@dataclass(frozen=True)
class PoseGraphResult:
    """An optimised pose graph.

    Attributes:
        S_cam_map: (K, 4, 4) similarities.
        cost_before, cost: half the sum of squared edge residuals.
        iterations: accepted steps.
    """

    S_cam_map: np.ndarray
    cost_before: float
    cost: float
    iterations: int


def optimize_pose_graph(
    S_cam_map: np.ndarray,
    edges: np.ndarray,
    measured: np.ndarray,
    fixed: np.ndarray,
    iterations: int = 20,
    weight: np.ndarray | None = None,
) -> PoseGraphResult:
    """Optimise a pose graph by Levenberg-Marquardt on Sim(3).

    The residual of an edge (i, j) is ``log(measured^-1 S_i S_j^-1)``.

    Args:
        S_cam_map: (K, 4, 4) start.
        edges: (E, 2) int node pairs i, j.
        measured: (E, 4, 4) similarity ``S_i S_j^-1`` as observed.
        fixed: (K,) bool fixed nodes; at least one.
        iterations: most steps tried.
        weight: (E, 7) of the squared residuals of rotation, translation and scale; None for 1.

    Raises:
        ValueError: no node is fixed, or an edge has a node that does not exist.
    """
    S = np.array(S_cam_map, np.float64)
    edges = np.asarray(edges).reshape(-1, 2)
    fixed = np.asarray(fixed, bool)
    if not fixed.any():
        raise ValueError("a pose graph needs a fixed node")
    if len(edges) and (edges.min() < 0 or edges.max() >= len(S)):
        raise ValueError(f"an edge leads to a node outside 0 to {len(S) - 1}")
    graph = _Graph(
        S,
        edges,
        invert_sim3(np.asarray(measured, np.float64).reshape(-1, 4, 4)),
        np.ones((len(edges), _DIM)) if weight is None else np.sqrt(weight),
        np.where(fixed, -1, np.cumsum(~fixed) - 1),
    )
    before = graph.cost
    if not (~fixed).any() or not len(edges):
        return PoseGraphResult(S, before, before, 0)
    cost, accepted = minimise.py_func(
        _Graph.linearise, _Graph.propose, _Graph.accept, graph, before, iterations, 1e-6, 1e-9
    )
    return PoseGraphResult(graph.S, before, cost, accepted)


class _Graph:
    """A pose graph as a problem of least squares.

    Attributes:
        S: (K, 4, 4) its state.
        cost: half the sum of its squared residuals.
    """

    def __init__(
        self,
        S: np.ndarray,
        edges: np.ndarray,
        inverse_measured: np.ndarray,
        root: np.ndarray,
        slot: np.ndarray,
    ) -> None:
        self._edges, self._inverse_measured, self._root, self._slot = edges, inverse_measured, root, slot
        self._try(S)
        self.accept()

    def _try(self, S: np.ndarray) -> float:
        residuals = log_sim3(
            self._inverse_measured @ S[self._edges[:, 0]] @ invert_sim3(S[self._edges[:, 1]])
        )
        self._trial = S, residuals, 0.5 * float(((self._root * residuals) ** 2).sum())
        return self._trial[-1]

    def accept(self) -> None:
        """Make the trial state the state."""
        self.S, self._residuals, self.cost = self._trial

    def linearise(self) -> None:
        """Compute the model about the state."""
        self._H, self._gradient = _normal_equations(
            self._residuals, self._edges, self._inverse_measured, self._slot, self._root
        )

    def propose(self, damping: float) -> tuple[float, float]:
        """Try a step: its cost, and the gain that the model predicts."""
        H, gradient = self._H, self._gradient
        damped = H + damping * identity(len(gradient))
        step = splu(damped.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(-gradient)
        S, free = self.S.copy(), self._slot >= 0
        S[free] = exp_sim3(step.reshape(-1, _DIM)) @ S[free]
        return self._try(S), 0.5 * float(step @ (damping * step - gradient))


def _normal_equations(
    residuals: np.ndarray,
    edges: np.ndarray,
    inverse_measured: np.ndarray,
    slot: np.ndarray,
    root: np.ndarray,
) -> tuple[coo_matrix, np.ndarray]:
    """Sparse Hessian (7F, 7F) and gradient (7F,) over the F free nodes."""
    left, right = inverse_jacobians(residuals)
    jacobians = (root[:, :, None] * (left @ adjoint_sim3(inverse_measured)), -root[:, :, None] * right)
    slots = (slot[edges[:, 0]], slot[edges[:, 1]])
    size = _DIM * (int(slot.max()) + 1)
    gradient = np.zeros(size)
    rows, columns, values = [], [], []
    within = np.arange(_DIM)
    for a, J_a in zip(slots, jacobians, strict=True):
        free = a >= 0
        part = np.einsum("nki,nk->ni", J_a[free], (root * residuals)[free])
        np.add.at(gradient.reshape(-1, _DIM), a[free], part)
        for b, J_b in zip(slots, jacobians, strict=True):
            both = free & (b >= 0)
            block = np.einsum("nki,nkj->nij", J_a[both], J_b[both])
            rows.append(np.broadcast_to((_DIM * a[both])[:, None, None] + within[:, None], block.shape))
            columns.append(np.broadcast_to((_DIM * b[both])[:, None, None] + within, block.shape))
            values.append(block)
    flat = [np.concatenate([x.ravel() for x in parts]) for parts in (values, rows, columns)]
    return coo_matrix((flat[0], (flat[1], flat[2])), shape=(size, size)), gradient
