"""Rigid motions in kernels: steps on SE(3) and orthonormalisation.

A twist is ``(translation, rotation)``; a step multiplies from the left, ``T <- exp(twist) T``.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def rodrigues_coefficients(theta2):
    """Coefficients sin(θ)/θ, (1 - cos θ)/θ² and (θ - sin θ)/θ³ of θ², exact to rounding down to zero."""
    if theta2 < 1e-3:
        a = 1.0 - theta2 / 6.0 * (1.0 - theta2 / 20.0 * (1.0 - theta2 / 42.0))
        b = 0.5 - theta2 / 24.0 * (1.0 - theta2 / 30.0 * (1.0 - theta2 / 56.0))
        c = 1.0 / 6.0 - theta2 / 120.0 * (1.0 - theta2 / 42.0 * (1.0 - theta2 / 72.0))
        return a, b, c
    theta = np.sqrt(theta2)
    sine = np.sin(theta)
    half = np.sin(0.5 * theta)
    return sine / theta, 2.0 * half * half / theta2, (theta - sine) / (theta2 * theta)


@njit(cache=True, nogil=True)
def so3_exp(wx, wy, wz):
    """(3, 3) rotation by the vector ``w``, rad."""
    a, b, _ = rodrigues_coefficients(wx * wx + wy * wy + wz * wz)
    return np.array(
        [
            [1.0 - b * (wy * wy + wz * wz), b * wx * wy - a * wz, b * wx * wz + a * wy],
            [b * wx * wy + a * wz, 1.0 - b * (wx * wx + wz * wz), b * wy * wz - a * wx],
            [b * wx * wz - a * wy, b * wy * wz + a * wx, 1.0 - b * (wx * wx + wy * wy)],
        ]
    )


@njit(cache=True, nogil=True)
def retract(T, twist, out):
    """Write ``exp(twist) T`` to ``out``.

    Args:
        T: (4, 4) rigid motion.
        twist: (6,) translation, then rotation in rad.
        out: (4, 4) with the last row already (0, 0, 0, 1); not ``T`` itself.
    """
    vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    _, b, c = rodrigues_coefficients(wx * wx + wy * wy + wz * wz)
    R = so3_exp(wx, wy, wz)
    # The left Jacobian applied to v: v + b (w x v) + c w x (w x v).
    ux, uy, uz = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
    shift_x = vx + b * ux + c * (wy * uz - wz * uy)
    shift_y = vy + b * uy + c * (wz * ux - wx * uz)
    shift_z = vz + b * uz + c * (wx * uy - wy * ux)
    for i in range(3):
        for j in range(4):
            out[i, j] = R[i, 0] * T[0, j] + R[i, 1] * T[1, j] + R[i, 2] * T[2, j]
    out[0, 3] += shift_x
    out[1, 3] += shift_y
    out[2, 3] += shift_z


@njit(cache=True, nogil=True)
def orthonormalise(T):
    """Orthonormalise the rotation of ``T`` (4, 4), in place: one Newton step of the polar form."""
    R = T[:3, :3].copy()
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                gram = R[0, k] * R[0, j] + R[1, k] * R[1, j] + R[2, k] * R[2, j]
                total += R[i, k] * gram
            T[i, j] = 1.5 * R[i, j] - 0.5 * total
