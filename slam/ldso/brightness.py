"""Affine brightness of views: intensity is exp(a) times the scene's, plus b."""

import numpy as np


def relative(of: np.ndarray, to: np.ndarray) -> np.ndarray:
    """(2,) brightness of one view relative to another, from those of both, (2,) each."""
    a = of[0] - to[0]
    return np.array([a, of[1] - np.exp(a) * to[1]])


def composed(change: np.ndarray, of: np.ndarray) -> np.ndarray:
    """(2,) brightness of a view that is changed by ``change`` (2,) from another's, (2,)."""
    return np.array([of[0] + change[0], change[1] + np.exp(change[0]) * of[1]])


def relative_of_all(affine: np.ndarray) -> np.ndarray:
    """(S, S, 2) brightness of view t relative to view h at [h, t], from (S, 2)."""
    a = affine[None, :, 0] - affine[:, None, 0]
    return np.stack([a, affine[None, :, 1] - np.exp(a) * affine[:, None, 1]], axis=-1)
