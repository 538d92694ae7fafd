"""Errors of matches under a relative pose, and the normal equations of their robust cost.

Matches are one (5, N) array: normalised keypoint of view 1 (x, y), of view 2 (x, y), and their noise in the
same units. The loop over them uses scalars only, without branches and stores, so that it is vectorised: it
takes most of a frame's time during initialisation.
"""

import numpy as np
from numba import njit

_TINY = 1e-300


@njit(inline="always")
def _scalars(R, t):
    """Motion as scalars: the rows of ``R``, ``t``, and its part of the noise."""
    r00, r01, r02, r10, r11, r12 = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    r20, r21, r22, t0, t1, t2 = R[2, 0], R[2, 1], R[2, 2], t[0], t[1], t[2]
    # Squared norm of the upper left 2x2 block of the essential matrix [t]x R.
    corner = (t1 * r20 - t2 * r10) ** 2 + (t1 * r21 - t2 * r11) ** 2
    corner += (t2 * r00 - t0 * r20) ** 2 + (t2 * r01 - t0 * r21) ** 2
    return (r00, r01, r02), (r10, r11, r12), (r20, r21, r22), (t0, t1, t2), corner


@njit(inline="always")
def _rotated(R0, R1, R2, x, y):
    """Ray of view 1 rotated to view 2."""
    return (
        R0[0] * x + R0[1] * y + R0[2],
        R1[0] * x + R1[1] * y + R1[2],
        R2[0] * x + R2[1] * y + R2[2],
    )


@njit(inline="always")
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(inline="always")
def _off_line(R0, R1, R2, t, q, x2, y2, noise, weight):
    """Sampson distance to the epipolar lines, in sigmas, and its gradients.

    Args:
        R0, R1, R2, t: the motion.
        q: the ray of view 1 in view 2.
        x2, y2: keypoint of view 2.
        noise: second-order term of the noise, relevant near the epipoles, where the lines lose their
            direction. The gradients neglect that it changes with the motion.
        weight: one over sigma.

    Returns:
        The error, its gradient in the rotation from the left, its gradient in ``t``.

    Source: Sampson error: Hartley, Zisserman, "Multiple View Geometry", 2003, section 11.4.3.
    """
    qx, qy, qz = q
    # Epipolar lines: t x q in view 2, R^T m with m = ray_2 x t in view 1.
    a, b, c = _cross(t[0], t[1], t[2], qx, qy, qz)
    mx, my, mz = _cross(x2, y2, 1.0, t[0], t[1], t[2])
    d, e = R0[0] * mx + R1[0] * my + R2[0] * mz, R0[1] * mx + R1[1] * my + R2[1] * mz
    inverse = 1.0 / (a * a + b * b + d * d + e * e + noise)
    scale = weight * np.sqrt(inverse)
    off = (x2 * a + y2 * b + c) * scale
    # Gradients in the line t x q and in m, from there in q and t.
    f = -off * inverse
    lx, ly, lz = scale * x2 + f * a, scale * y2 + f * b, scale
    nx, ny, nz = f * (d * R0[0] + e * R0[1]), f * (d * R1[0] + e * R1[1]), f * (d * R2[0] + e * R2[1])
    px, py, pz = _cross(lx, ly, lz, t[0], t[1], t[2])
    ux, uy, uz = _cross(qx, qy, qz, px, py, pz)
    vx, vy, vz = _cross(mx, my, mz, nx, ny, nz)
    sx, sy, sz = _cross(qx, qy, qz, lx, ly, lz)
    ox, oy, oz = _cross(nx, ny, nz, x2, y2, 1.0)
    return off, (ux - vx, uy - vy, uz - vz), (sx + ox, sy + oy, sz + oz)


@njit(inline="always")
def _behind_infinity(t, q, x2, y2, noise, weight):
    """Distance of a keypoint beyond the image of infinity along the epipolar line, in sigmas.

    The point of such a keypoint is behind a camera. The error is negative there and zero elsewhere. Arguments
    and return values as of :func:`_off_line`.
    """
    qx, qy, qz = q
    back = not qz > 0.0
    inverse_z = 1.0 / qz
    zx, zy = qx * inverse_z, qy * inverse_z
    # Distance from the image of infinity to the keypoint, towards nearer points. The direction is taken at
    # the end farther from the epipole, so that keypoints beyond the epipole count as behind.
    at_infinity = t[2] < 0.0
    ex, ey = zx if at_infinity else x2, zy if at_infinity else y2
    du, dv = t[0] - ex * t[2], t[1] - ey * t[2]
    wx, wy = x2 - zx, y2 - zy
    inverse = 1.0 / (du * du + dv * dv + noise)
    scale = weight * np.sqrt(0.5 * inverse)
    along = (wx * du + wy * dv) * scale
    beyond = along < 0.0
    behind = -weight if back else (along if beyond else 0.0)
    # Gradients in the direction (du, dv) and in the image of infinity, from there in t and q.
    scale = scale if beyond else 0.0
    f = (along if beyond else 0.0) * inverse
    gu, gv = scale * wx - f * du, scale * wy - f * dv
    iu, iv = -scale * du, -scale * dv
    iu, iv = iu - t[2] * gu if at_infinity else iu, iv - t[2] * gv if at_infinity else iv
    gw, px, py, pz = -(ex * gu + ey * gv), iu * inverse_z, iv * inverse_z, -(zx * iu + zy * iv) * inverse_z
    ux, uy, uz = _cross(qx, qy, qz, px, py, pz)
    turn = 0.0 if back else ux, 0.0 if back else uy, 0.0 if back else uz
    return behind, turn, (0.0 if back else gu, 0.0 if back else gv, 0.0 if back else gw)


@njit(cache=True, nogil=True, error_model="numpy")
def motion_errors(R, t, matches, errors):
    """Compute the errors of matches under a motion, in sigmas.

    Args:
        R, t: camera 1 to camera 2, unit baseline.
        matches: (5, N).
        errors: (2, N), receives the signed Sampson distances to the epipolar lines, and the distances beyond
            the image of infinity along the line, negative if the point is behind a camera, else zero.
    """
    R0, R1, R2, t, corner = _scalars(R, t)
    X1, Y1, X2, Y2, S = matches[0], matches[1], matches[2], matches[3], matches[4]
    for i in range(np.uint64(len(S))):
        x2, y2, noise, weight = X2[i], Y2[i], S[i] * S[i] * corner + _TINY, 1.0 / S[i]
        q = _rotated(R0, R1, R2, X1[i], Y1[i])
        errors[0, i], _, _ = _off_line(R0, R1, R2, t, q, x2, y2, noise, weight)
        errors[1, i], _, _ = _behind_infinity(t, q, x2, y2, noise, weight)


# The sums may be reordered, which lets them use vector registers.
@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def normal_equations(R, t, u, v, matches, c2, weight_c2, H, g):
    """Fill the normal equations of the reweighted squares.

    Args:
        R, t: camera 1 to camera 2, unit baseline.
        u, v: (3,) directions in which the direction of ``t`` moves.
        matches: (5, N).
        c2: squared error from which a match has no influence.
        weight_c2: the same, for the equations.
        H: (5, 5), receives the lower triangle; rotation from the left, then steps along ``u`` and ``v``.
        g: (5,) receives half the gradient.

    Returns:
        Robust cost under ``c2`` and under ``weight_c2``: Tukey's loss, the squared error itself if small.
    """
    R0, R1, R2, t, corner = _scalars(R, t)
    u0, u1, u2, v0, v1, v2 = u[0], u[1], u[2], v[0], v[1], v[2]
    X1, Y1, X2, Y2, S = matches[0], matches[1], matches[2], matches[3], matches[4]
    cost = weight_cost = g0 = g1 = g2 = g3 = g4 = h00 = h10 = h11 = h20 = h21 = h22 = 0.0
    h30 = h31 = h32 = h33 = h40 = h41 = h42 = h43 = h44 = 0.0
    for i in range(np.uint64(len(S))):
        x2, y2, noise, weight = X2[i], Y2[i], S[i] * S[i] * corner + _TINY, 1.0 / S[i]
        q = _rotated(R0, R1, R2, X1[i], Y1[i])
        off, (j0, j1, j2), (sx, sy, sz) = _off_line(R0, R1, R2, t, q, x2, y2, noise, weight)
        behind, (k0, k1, k2), (rx, ry, rz) = _behind_infinity(t, q, x2, y2, noise, weight)
        j3, j4 = sx * u0 + sy * u1 + sz * u2, sx * v0 + sy * v1 + sz * v2
        k3, k4 = rx * u0 + ry * u1 + rz * u2, rx * v0 + ry * v1 + rz * v2
        e2 = off * off + behind * behind
        left = 1.0 - e2 / c2
        left = left if left > 0.0 else 0.0
        cost += 1.0 - left * left * left
        left = 1.0 - e2 / weight_c2
        left = left if left > 0.0 else 0.0
        weight_cost += 1.0 - left * left * left
        w = left * left
        a0, a1, a2, a3, a4 = w * j0, w * j1, w * j2, w * j3, w * j4
        b0, b1, b2, b3, b4 = w * k0, w * k1, w * k2, w * k3, w * k4
        g0 += a0 * off + b0 * behind
        g1 += a1 * off + b1 * behind
        g2 += a2 * off + b2 * behind
        g3 += a3 * off + b3 * behind
        g4 += a4 * off + b4 * behind
        h00 += a0 * j0 + b0 * k0
        h10 += a1 * j0 + b1 * k0
        h11 += a1 * j1 + b1 * k1
        h20 += a2 * j0 + b2 * k0
        h21 += a2 * j1 + b2 * k1
        h22 += a2 * j2 + b2 * k2
        h30 += a3 * j0 + b3 * k0
        h31 += a3 * j1 + b3 * k1
        h32 += a3 * j2 + b3 * k2
        h33 += a3 * j3 + b3 * k3
        h40 += a4 * j0 + b4 * k0
        h41 += a4 * j1 + b4 * k1
        h42 += a4 * j2 + b4 * k2
        h43 += a4 * j3 + b4 * k3
        h44 += a4 * j4 + b4 * k4
    g[0], g[1], g[2], g[3], g[4] = g0, g1, g2, g3, g4
    H[0, 0], H[1, 0], H[1, 1], H[2, 0], H[2, 1], H[2, 2] = h00, h10, h11, h20, h21, h22
    H[3, 0], H[3, 1], H[3, 2], H[3, 3] = h30, h31, h32, h33
    H[4, 0], H[4, 1], H[4, 2], H[4, 3], H[4, 4] = h40, h41, h42, h43, h44
    return cost * c2 / 3.0, weight_cost * weight_c2 / 3.0
