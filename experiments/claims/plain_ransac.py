"""Plain RANSAC for an essential matrix: as many samples of five matches as asked, and the most inliers win.

OpenCV's own stops as soon as its confidence is reached, which no setting turns off: asked for 50,000 samples
at an inlier share of .87 it draws 43.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

_CHUNK = 50  # samples at once: their scores stay in the cache
_REAL = 1e-8
# Exponents of x, y, z of monomials: ten of degree three, and ten below that span the quotient ring.
_EXPONENTS = [of for of in product(range(4), repeat=3) if sum(of) <= 3]
_CUBIC = [of for of in _EXPONENTS if sum(of) == 3]
_LOWER = sorted((of for of in _EXPONENTS if sum(of) < 3), key=sum, reverse=True)
_LINEAR = [_LOWER.index(of) for of in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
# Points at which the constraints are evaluated: polynomials of degree three are fixed by their values there.
_NODES = np.array(_EXPONENTS) * 2 / 3 - 0.5
_TO_COEFFICIENTS = np.linalg.inv(np.prod(_NODES[:, None] ** np.array(_CUBIC + _LOWER)[None], axis=2)).T


def five_point(x1: np.ndarray, x2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Essential matrices of samples of five matches.

    Args:
        x1, x2: (B, 5, 3) rays.

    Returns:
        (M, 3, 3) all real solutions of unit norm, and (M,) the sample of each.

    Source: Stewénius, Engels, Nistér, "Recent developments on direct relative orientation", 2006: E is a
    combination of four matrices that fulfil the five epipolar constraints; det E = 0 and
    2 E E^T E = tr(E E^T) E are ten cubics in its three coefficients, by which multiplication by the first one
    is linear on the ten lower monomials. Its eigenvectors are the solutions.
    """
    constraints = (x2[:, :, :, None] * x1[:, :, None, :]).reshape(-1, 5, 9)
    null = np.linalg.qr(constraints.transpose(0, 2, 1), mode="complete")[0][:, :, 5:]
    basis = null.transpose(0, 2, 1).reshape(-1, 4, 3, 3)
    weights = np.column_stack([_NODES, np.ones(len(_NODES))])
    E = np.einsum("nk,bkij->bnij", weights, basis)
    EEt = E @ E.transpose(0, 1, 3, 2)
    traces = np.trace(EEt, axis1=2, axis2=3)[:, :, None, None]
    values = np.concatenate([(2 * EEt - traces * np.eye(3)) @ E], axis=1).reshape(len(E), len(_NODES), 9)
    values = np.concatenate([values, np.linalg.det(E)[:, :, None]], axis=2)
    coefficients = np.einsum("bnc,nm->bcm", values, _TO_COEFFICIENTS)
    try:
        cubic = -np.linalg.solve(coefficients[:, :, :10], coefficients[:, :, 10:])
    except np.linalg.LinAlgError:  # a sample with a match twice
        cubic = -np.linalg.pinv(coefficients[:, :, :10]) @ coefficients[:, :, 10:]
    times_x = np.zeros((len(E), 10, 10))
    for row, (a, b, c) in enumerate(_LOWER):
        raised = (a + 1, b, c)
        if raised in _CUBIC:
            times_x[:, row] = cubic[:, _CUBIC.index(raised)]
        else:
            times_x[:, row, _LOWER.index(raised)] = 1
    values, vectors = np.linalg.eig(times_x)
    real = (np.abs(values.imag) < _REAL * (1 + np.abs(values.real))) & (np.abs(vectors[:, -1]) > 1e-12)
    samples, roots = np.nonzero(real)
    of = vectors[samples, :, roots]
    xyz = (of[:, _LINEAR] / of[:, -1:]).real
    found = np.einsum("mk,mkij->mij", xyz, basis[samples, :3]) + basis[samples, 3]
    return found / np.linalg.norm(found, axis=(1, 2), keepdims=True), samples


class InlierCount:
    """Counts the matches whose Sampson error under an essential matrix is at most a threshold.

    Args:
        x1, x2: (N, 3) rays of unit depth.
        threshold: in units of the rays: pixels over the focal length.
    """

    def __init__(self, x1: np.ndarray, x2: np.ndarray, threshold: float) -> None:
        # Error and its gradient are linear in E and in its products: two matrix products for many E.
        self._outer = (x2[:, :, None] * x1[:, None, :]).reshape(-1, 9).T.copy()
        of1, of2 = (np.einsum("ni,nj->nij", x, x).reshape(-1, 9) for x in (x1, x2))
        self._squares = threshold**2 * np.hstack([of1, of2]).T.copy()

    def masks(self, E: np.ndarray) -> np.ndarray:
        """(M, N) bool, true for inliers of (M, 3, 3) matrices."""
        errors = E.reshape(-1, 9) @ self._outer
        of1 = np.einsum("mki,mkj->mij", E[:, :2], E[:, :2]).reshape(-1, 9)
        of2 = np.einsum("mik,mjk->mij", E[:, :, :2], E[:, :, :2]).reshape(-1, 9)
        return errors**2 <= np.hstack([of1, of2]) @ self._squares


def plain_ransac(
    x1: np.ndarray, x2: np.ndarray, threshold: float, counts: Sequence[int], rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The best of the first samples, for several numbers of them.

    Args:
        x1, x2: (N, 3) rays of unit depth of the matches, at least five.
        threshold: see :class:`InlierCount`.
        counts: increasing numbers of samples; those of a smaller one are the first of a larger one.
        rng: of the samples.

    Returns:
        For each number the (3, 3) essential matrix with most inliers, of equal ones the first, and its (N,)
        inliers; zeros while no sample has a solution.
    """
    inliers = InlierCount(x1, x2, threshold)
    best, most, drawn, found = np.zeros((3, 3)), -1, 0, []
    for count in counts:
        while drawn < count:
            size = min(_CHUNK, count - drawn)
            drawn += size
            sample = _samples(len(x1), size, rng)
            E, _ = five_point(x1[sample], x2[sample])
            if not len(E):
                continue
            each = np.count_nonzero(inliers.masks(E), axis=1)
            if each.max() > most:
                most, best = int(each.max()), E[int(each.argmax())]
        found.append((best, inliers.masks(best[None])[0] if most >= 0 else np.zeros(len(x1), bool)))
    return found


def _samples(n: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """(size, 5) distinct indices below n, each five equally likely."""
    drawn = rng.integers(n, size=(size, 5))
    while True:
        ordered = np.sort(drawn, axis=1)
        twice = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
        if not len(twice):
            return drawn
        drawn[twice] = rng.integers(n, size=(len(twice), 5))
