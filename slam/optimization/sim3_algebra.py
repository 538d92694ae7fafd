"""Lie group Sim(3), vectorised over stacks of similarities.

A similarity is ``S = [sR t; 0 1]``; a twist is (omega, upsilon, sigma), seven numbers, with
``S = exp([sigma I + [omega]x, upsilon; 0 0])``, hence ``s = exp(sigma)``.

Source: Strasdat, Local Accuracy and Global Consistency for Efficient Visual SLAM, 2012, appendix A; the
functions of ``sigma I + [omega]x`` by its eigenvalues, sigma and sigma +- i |omega|.
"""

import numpy as np
from scipy.spatial.transform import Rotation

# Coefficients B_n / n! of the Bernoulli numbers, n = 2, 4, 6, 8, on the powers of the adjoint.
_BERNOULLI = (1 / 12, -1 / 720, 1 / 30240, -1 / 1209600)


def exp_sim3(twists: np.ndarray) -> np.ndarray:
    """(N, 4, 4) similarities of (N, 7) twists."""
    omega, upsilon, sigma = twists[:, :3], twists[:, 3:6], twists[:, 6]
    S = np.zeros((len(twists), 4, 4))
    S[:, :3, :3] = np.exp(sigma)[:, None, None] * Rotation.from_rotvec(omega).as_matrix()
    S[:, :3, 3] = np.einsum("nij,nj->ni", _mean_of_exp(omega, sigma), upsilon)
    S[:, 3, 3] = 1.0
    return S


def log_sim3(S: np.ndarray) -> np.ndarray:
    """(N, 7) twists of (N, 4, 4) similarities, rotations below 180 degrees."""
    s = scales(S)
    omega = Rotation.from_matrix(S[:, :3, :3] / s[:, None, None]).as_rotvec()
    sigma = np.log(s)
    upsilon = np.linalg.solve(_mean_of_exp(omega, sigma), S[:, :3, 3:])[:, :, 0]
    return np.concatenate([omega, upsilon, sigma[:, None]], axis=1)


def invert_sim3(S: np.ndarray) -> np.ndarray:
    """(N, 4, 4) inverses of (N, 4, 4) similarities."""
    inverse = np.zeros_like(S)
    inverse[:, :3, :3] = np.swapaxes(S[:, :3, :3], 1, 2) / (scales(S) ** 2)[:, None, None]
    inverse[:, :3, 3] = -np.einsum("nij,nj->ni", inverse[:, :3, :3], S[:, :3, 3])
    inverse[:, 3, 3] = 1.0
    return inverse


def scales(S: np.ndarray) -> np.ndarray:
    """(N,) scales of (N, 4, 4) similarities."""
    return np.cbrt(np.linalg.det(S[:, :3, :3]))


def adjoint_sim3(S: np.ndarray) -> np.ndarray:
    """(N, 7, 7) adjoints: ``S exp(x) S^-1 = exp(adjoint x)``."""
    L, t, s = S[:, :3, :3], S[:, :3, 3], scales(S)
    R = L / s[:, None, None]
    A = np.zeros((len(S), 7, 7))
    A[:, :3, :3] = R
    A[:, 3:6, :3] = hat(t) @ R
    A[:, 3:6, 3:6] = L
    A[:, 3:6, 6] = -t
    A[:, 6, 6] = 1.0
    return A


def inverse_jacobians(twists: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Left and right inverse Jacobians (N, 7, 7) of the logarithm at moderate twists.

    ``log(exp(a) S) = log S + left a`` and ``log(S exp(b)) = log S + right b`` to first order.
    """
    n = len(twists)
    ad = np.zeros((n, 7, 7))
    turn = hat(twists[:, :3])
    ad[:, :3, :3] = turn
    ad[:, 3:6, :3] = hat(twists[:, 3:6])
    ad[:, 3:6, 3:6] = turn + twists[:, 6, None, None] * np.eye(3)
    ad[:, 3:6, 6] = -twists[:, 3:6]
    even = np.broadcast_to(np.eye(7), (n, 7, 7)).copy()
    square = ad @ ad
    power = np.broadcast_to(np.eye(7), (n, 7, 7))
    for coefficient in _BERNOULLI:
        power = power @ square
        even += coefficient * power
    return even - 0.5 * ad, even + 0.5 * ad


def hat(v: np.ndarray) -> np.ndarray:
    """(N, 3, 3) matrices of the cross product with (N, 3) vectors."""
    H = np.zeros((len(v), 3, 3))
    H[:, 0, 1], H[:, 0, 2], H[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return H - np.swapaxes(H, 1, 2)


def _mean_of_exp(omega: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """(N, 3, 3) integral of ``exp(u (sigma I + [omega]x))`` over u from 0 to 1."""
    theta = np.linalg.norm(omega, axis=1)
    K = hat(omega / np.where(theta > 0, theta, 1.0)[:, None])
    along = _phi(sigma.astype(complex)).real
    across = _phi(sigma + 1j * theta)
    return (
        along[:, None, None] * np.eye(3)
        + across.imag[:, None, None] * K
        + (along - across.real)[:, None, None] * (K @ K)
    )


def _phi(z: np.ndarray) -> np.ndarray:
    """Function (exp(z) - 1) / z of complex numbers, 1 at zero."""
    small = np.abs(z) < 1e-12
    return np.where(small, 1.0, np.expm1(z) / np.where(small, 1.0, z))
