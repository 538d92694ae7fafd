"""Kernels of the photometric bundle adjustment: all residuals of a window with their Gauss-Newton model.

A residual is the pattern of a point in one keyframe beside its host. Its eight pixels share the geometric
part of their Jacobian, that of the point itself, taken at the first estimates of the poses.

Eight points of one host go through each stage together, so that its loops over them are vectorised: what the
stages hand on lies in rows of one table, a column per point.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.2 and 2.3. The bound of a residual is
the larger of those of its two keyframes.
"""

import numpy as np
from numba import njit

_POINTS = 8
_PIXELS = np.uint64(8)
_ZERO, _ONE, _TWO, _THREE, _SIX = (np.uint64(n) for n in (0, 1, 2, 3, 6))
_TEXELS = np.uint64(12)

# Rows of the table, of a point or of each pixel of its pattern. Unsigned: Numba need not look whether they
# count from the end.
_RAY_X, _RAY_Y, _DEPTH, _VALID, _AT_X, _AT_Y, _AT_Z = (np.uint64(n) for n in range(7))
_PIXEL_X, _PIXEL_Y, _INTENSITY, _WEIGHT, _U, _V, _VALUE, _SLOPE_X, _SLOPE_Y = (
    np.uint64(8 * n) for n in range(1, 10)
)
# Sums over a pattern of the products of x and y, the image gradient, a and b, the derivatives by brightness,
# and r, the residual; then of the costs.
_XX, _XY, _YY, _XA, _YA, _XB, _YB, _XR, _YR, _AA, _AB, _BB, _AR, _BR, _COST = (
    np.uint64(80 + n) for n in range(15)
)
_J_X, _J_Y = np.uint64(96), np.uint64(102)  # six rows each: derivatives of a pixel's place by the motion
_INFORMATION, _GRADIENT, _S_X, _S_Y, _LINK = (np.uint64(108 + n) for n in range(5))  # eight rows of links
_ROWS = 120
_TERMS = 44  # of H and b of a pair, those of its upper triangle


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _place(F, count, work):
    """Where the points themselves are seen at the first estimates, at depth one, and their depth."""
    F_00, F_01, F_02, F_03 = F[0, 0], F[0, 1], F[0, 2], F[0, 3]
    F_10, F_11, F_12, F_13 = F[1, 0], F[1, 1], F[1, 2], F[1, 3]
    F_20, F_21, F_22, F_23 = F[2, 0], F[2, 1], F[2, 2], F[2, 3]
    for p in range(count):
        x, y, d = work[_RAY_X, p], work[_RAY_Y, p], work[_DEPTH, p]
        z = F_20 * x + F_21 * y + F_22 + F_23 * d
        ahead = z > 1e-6
        z = z if ahead else 1.0
        work[_VALID, p] = work[_VALID, p] if ahead else 0.0
        work[_AT_X, p] = (F_00 * x + F_01 * y + F_02 + F_03 * d) / z
        work[_AT_Y, p] = (F_10 * x + F_11 * y + F_12 + F_13 * d) / z
        work[_AT_Z, p] = z


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _project(M, fx, fy, cx, cy, right, bottom, count, work):
    """Where each pixel of the patterns is seen; a point with one outside the image is not valid."""
    M_00, M_01, M_02, M_03 = M[0, 0], M[0, 1], M[0, 2], M[0, 3]
    M_10, M_11, M_12, M_13 = M[1, 0], M[1, 1], M[1, 2], M[1, 3]
    M_20, M_21, M_22, M_23 = M[2, 0], M[2, 1], M[2, 2], M[2, 3]
    for k in range(_PIXELS):
        for p in range(count):
            x, y, d = work[_PIXEL_X + k, p], work[_PIXEL_Y + k, p], work[_DEPTH, p]
            z = M_20 * x + M_21 * y + M_22 + M_23 * d
            u = fx * (M_00 * x + M_01 * y + M_02 + M_03 * d) / z + cx
            v = fy * (M_10 * x + M_11 * y + M_12 + M_13 * d) / z + cy
            # One by one: joined by "and" they would be branches, which are not vectorised.
            valid = work[_VALID, p] if z > 1e-6 else 0.0
            valid = valid if u >= 1.0 else 0.0
            valid = valid if u < right else 0.0
            valid = valid if v >= 1.0 else 0.0
            work[_VALID, p] = valid if v < bottom else 0.0
            work[_U + k, p], work[_V + k, p] = u, v


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _load(level, width, count, work, texel):
    """The four pixels about each of them, of all three channels; the one stage that is not vectorised."""
    for p in range(count):
        if work[_VALID, p] == 0.0:
            for k in range(_PIXELS):
                for m in range(_TEXELS):
                    texel[m, k, p] = np.float32(0.0)
            continue
        for k in range(_PIXELS):
            column, row = np.uint64(np.int32(work[_U + k, p])), np.uint64(np.int32(work[_V + k, p]))
            above = _THREE * (row * width + column)
            below = above + _THREE * width
            for m in range(_SIX):
                texel[m, k, p], texel[_SIX + m, k, p] = level[above + m], level[below + m]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sample(count, work, texel):
    """Intensity and image gradient there; a point with a pixel that has none is not valid."""
    for k in range(_PIXELS):
        for p in range(count):
            u, v = work[_U + k, p], work[_V + k, p]
            right, down = u - np.floor(u), v - np.floor(v)
            left, up = 1.0 - right, 1.0 - down
            work[_VALUE + k, p] = up * (left * texel[0, k, p] + right * texel[3, k, p]) + down * (
                left * texel[6, k, p] + right * texel[9, k, p]
            )
            work[_SLOPE_X + k, p] = up * (left * texel[1, k, p] + right * texel[4, k, p]) + down * (
                left * texel[7, k, p] + right * texel[10, k, p]
            )
            work[_SLOPE_Y + k, p] = up * (left * texel[2, k, p] + right * texel[5, k, p]) + down * (
                left * texel[8, k, p] + right * texel[11, k, p]
            )
    for p in range(count):
        size = 0.0
        for k in range(_PIXELS):
            size += abs(work[_VALUE + k, p]) + abs(work[_SLOPE_X + k, p]) + abs(work[_SLOPE_Y + k, p])
        if not size < np.inf:
            work[_VALID, p] = 0.0
            for k in range(_PIXELS):
                work[_VALUE + k, p], work[_SLOPE_X + k, p], work[_SLOPE_Y + k, p] = 0.0, 0.0, 0.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sum(gain, offset, huber, count, work):
    """Sums over the patterns."""
    for m in range(np.uint64(15)):
        for p in range(count):
            work[_XX + m, p] = 0.0
    for k in range(_PIXELS):
        for p in range(count):
            predicted = gain * work[_INTENSITY + k, p]
            r = work[_VALUE + k, p] - predicted - offset
            gx, gy, w = work[_SLOPE_X + k, p], work[_SLOPE_Y + k, p], work[_WEIGHT + k, p]
            size = abs(r)
            usual = size <= huber
            work[_COST, p] += w * (size * size if usual else huber * (2.0 * size - huber))
            w *= 1.0 if usual else huber / size
            wx, wy, wp = w * gx, w * gy, w * predicted
            work[_XX, p] += wx * gx
            work[_XY, p] += wx * gy
            work[_YY, p] += wy * gy
            work[_XA, p] -= wx * predicted
            work[_YA, p] -= wy * predicted
            work[_XB, p] -= wx
            work[_YB, p] -= wy
            work[_XR, p] += wx * r
            work[_YR, p] += wy * r
            work[_AA, p] += wp * predicted
            work[_AB, p] += wp
            work[_BB, p] += w
            work[_AR, p] -= wp * r
            work[_BR, p] -= w * r


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _differentiate(F, fx, fy, count, work):
    """Jacobians of the points, and what they make of the sums; zero where a point is not valid."""
    F_03, F_13, F_23 = F[0, 3], F[1, 3], F[2, 3]
    for m in range(np.uint64(14)):
        for p in range(count):
            work[_XX + m, p] *= work[_VALID, p]
    for p in range(count):
        px, py, z = work[_AT_X, p], work[_AT_Y, p], work[_AT_Z, p]
        near = work[_DEPTH, p] / z
        work[_J_X, p], work[_J_X + _ONE, p], work[_J_X + _TWO, p] = fx * near, 0.0, -fx * near * px
        work[_J_X + np.uint64(3), p], work[_J_X + np.uint64(4), p] = -fx * px * py, fx * (1.0 + px * px)
        work[_J_X + np.uint64(5), p] = -fx * py
        work[_J_Y, p], work[_J_Y + _ONE, p], work[_J_Y + _TWO, p] = 0.0, fy * near, -fy * near * py
        work[_J_Y + np.uint64(3), p], work[_J_Y + np.uint64(4), p] = -fy * (1.0 + py * py), fy * px * py
        work[_J_Y + np.uint64(5), p] = fy * px
        dx, dy = fx * (F_03 - px * F_23) / z, fy * (F_13 - py * F_23) / z
        sx = work[_XX, p] * dx + work[_XY, p] * dy
        sy = work[_XY, p] * dx + work[_YY, p] * dy
        work[_INFORMATION, p] = sx * dx + sy * dy
        work[_GRADIENT, p] = work[_XR, p] * dx + work[_YR, p] * dy
        work[_S_X, p], work[_S_Y, p] = sx, sy
        work[_LINK + np.uint64(6), p] = work[_XA, p] * dx + work[_YA, p] * dy
        work[_LINK + np.uint64(7), p] = work[_XB, p] * dx + work[_YB, p] * dy


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add(count, work, terms):
    """Add the terms of H and b."""
    t = _ZERO
    for m in range(_SIX):
        for p in range(count):
            work[_LINK + m, p] = work[_S_X, p] * work[_J_X + m, p] + work[_S_Y, p] * work[_J_Y + m, p]
    for m in range(_SIX):
        for n in range(m, _SIX):
            for p in range(count):
                jx, jy = work[_J_X + m, p], work[_J_Y + m, p]
                qx = work[_XX, p] * jx + work[_XY, p] * jy
                qy = work[_XY, p] * jx + work[_YY, p] * jy
                terms[t, p] += qx * work[_J_X + n, p] + qy * work[_J_Y + n, p]
            t += _ONE
        for p in range(count):
            jx, jy = work[_J_X + m, p], work[_J_Y + m, p]
            terms[t, p] += work[_XA, p] * jx + work[_YA, p] * jy
            terms[t + _ONE, p] += work[_XB, p] * jx + work[_YB, p] * jy
            terms[t + _TWO, p] += work[_XR, p] * jx + work[_YR, p] * jy
        t += _THREE
    for m in range(np.uint64(5)):
        for p in range(count):
            terms[t + m, p] += work[_AA + m, p]


@njit(cache=True, nogil=True)
def _collect(terms, H, b):
    """Add up the columns of the terms."""
    t = 0
    for m in range(6):
        for n in range(m, 8):
            H[m, n] += terms[t].sum()
            H[n, m] = H[m, n]
            t += 1
        b[m] += terms[t].sum()
        t += 1
    H[6, 6] += terms[t].sum()
    H[6, 7] += terms[t + 1].sum()
    H[7, 6] = H[6, 7]
    H[7, 7] += terms[t + 2].sum()
    b[6] += terms[t + 3].sum()
    b[7] += terms[t + 4].sum()


@njit(cache=True, nogil=True, error_model="numpy")
def linearise_window(
    images, camera, pattern, host, uv, inverse_depth, intensity, weight, taken, T, T_first, affine, huber,
    outlier, energy, seen, information, gradient, cross, H, b, total, sums,
):  # fmt: skip
    """Residuals and model of a window of S keyframes.

    The parameters of a pair of keyframes are the translation and rotation of a step
    ``T <- exp(twist) T`` of the motion host to target, and the target's a and b relative to the host.

    Args:
        images: (S, H, W, 3).
        camera, pattern, host, uv, inverse_depth, intensity, weight: of N points.
        taken: (N, S) bool, residuals to compute.
        T, T_first: (S, S, 4, 4) motion host to target at [host, target], as estimated and at the first
            estimates, where Jacobians are taken.
        affine: (S, S, 2) likewise.
        huber: residual beyond which it counts linearly.
        outlier: (S,) cost of a pattern beyond which it is not that surface and counts as this, per keyframe;
            the larger one of host and target decides.
        energy: (N, S) cost of each residual.
        seen: (N, S) int8: 1 where the point looks alike, 0 where it does not, -1 where it is not seen or not
            taken.
        information, gradient: (N,) on the inverse depth.
        cross: (N, S, 8) of the inverse depth with the pair's parameters.
        H, b: (S, S, 8, 8) and (S, S, 8) of the pairs' parameters.
        total: (S, S) costs of the pairs, those of patterns that are not seen left out.
        sums: (N, S, 9) weighted sums over the pattern of each residual that looks alike, of the image
            gradient g, the derivatives a, b by brightness and the residual r: gx gx, gx gy, gy gy, gx a,
            gy a, gx b, gy b, gx r, gy r; with N = 0 they are not written.
    """
    S, height, width = images.shape[0], images.shape[1], images.shape[2]
    N = host.shape[0]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gains = np.exp(affine[..., 0])
    information[:], gradient[:], cross[:] = 0.0, 0.0, 0.0
    energy[:], seen[:] = 0.0, -1
    H[:], b[:], total[:] = 0.0, 0.0, 0.0
    work, texel = np.zeros((_ROWS, _POINTS)), np.zeros((12, 8, _POINTS), np.float32)
    terms = np.zeros((S, _TERMS, _POINTS))
    # Points of a block, read off an argument of that length: loops of a constant length would be unrolled
    # instead of vectorised.
    count = np.uint64(pattern.shape[0])
    first = 0
    while first < N:
        h, last = host[first], first + 1
        while last < N and last < first + _POINTS and host[last] == h:
            last += 1
        for i in range(first, last):
            p, u, v = np.uint64(i - first), uv[i, 0], uv[i, 1]
            work[_RAY_X, p], work[_RAY_Y, p], work[_DEPTH, p] = (u - cx) / fx, (v - cy) / fy, inverse_depth[i]
            for k in range(_PIXELS):
                work[_PIXEL_X + k, p] = (u + pattern[k, 0] - cx) / fx
                work[_PIXEL_Y + k, p] = (v + pattern[k, 1] - cy) / fy
                work[_INTENSITY + k, p], work[_WEIGHT + k, p] = intensity[i, k], weight[i, k]
        for s in range(S):
            if s == h:
                continue
            work[_VALID, :] = 0.0
            for i in range(first, last):
                work[_VALID, np.uint64(i - first)] = 1.0 if taken[i, s] else 0.0
            if not work[_VALID].any():
                continue
            F = T_first[h, s]
            _place(F, count, work)
            _project(T[h, s], fx, fy, cx, cy, width - 2.0, height - 2.0, count, work)
            _load(images[s].reshape(-1), np.uint64(width), count, work, texel)
            _sample(count, work, texel)
            _sum(gains[h, s], affine[h, s, 1], huber, count, work)
            bound = max(outlier[h], outlier[s])
            for i in range(first, last):
                p = np.uint64(i - first)
                if work[_VALID, p] == 0.0:
                    continue
                energy[i, s], seen[i, s] = work[_COST, p], 1
                if energy[i, s] > bound:
                    energy[i, s], seen[i, s] = bound, 0
                    work[_VALID, p] = 0.0
                total[h, s] += energy[i, s]
            _differentiate(F, fx, fy, count, work)
            _add(count, work, terms[s])
            for i in range(first, last):
                p = np.uint64(i - first)
                information[i] += work[_INFORMATION, p]
                gradient[i] += work[_GRADIENT, p]
                for m in range(np.uint64(8)):
                    cross[i, s, m] = work[_LINK + m, p]
                if sums.shape[0]:
                    for m in range(np.uint64(9)):
                        sums[i, s, m] = work[_XX + m, p]
        if last == N or host[last] != h:
            for s in range(S):
                _collect(terms[s], H[h, s], b[h, s])
            terms[:] = 0.0
        first = last


@njit(cache=True, nogil=True)
def to_keyframes(host, cross, of_host, of_target, out):
    """Write the terms of inverse depths and pairs, (N, S, 8), as terms with keyframes, out (N, S, 8).

    Args:
        host: (N,) rows.
        cross: (N, S, 8) as of :func:`linearise_window`.
        of_host, of_target: (S, S, 8, 8) derivatives of a pair's parameters by those of its keyframes. What is
            zero in them by their form is not read: a target's own are the identity but for how a tells
            in b, a host's are an adjoint (translation, rotation) and a lower triangle for a and b.
    """
    out[:] = 0.0
    for i in range(np.uint64(host.shape[0])):
        h = np.uint64(host[i])
        for s in range(np.uint64(cross.shape[1])):
            if cross[i, s, 7] == 0.0 and cross[i, s, 0] == 0.0 and cross[i, s, 6] == 0.0:
                continue
            A = of_host[h, s]
            c0, c1, c2, c3 = cross[i, s, 0], cross[i, s, 1], cross[i, s, 2], cross[i, s, 3]
            c4, c5, c6, c7 = cross[i, s, 4], cross[i, s, 5], cross[i, s, 6], cross[i, s, 7]
            for n in range(_THREE):
                r = _THREE + n
                out[i, h, n] = out[i, h, n] + c0 * A[0, n] + c1 * A[1, n] + c2 * A[2, n]
                moved = out[i, h, r] + c0 * A[0, r] + c1 * A[1, r] + c2 * A[2, r]
                out[i, h, r] = moved + c3 * A[3, r] + c4 * A[4, r] + c5 * A[5, r]
            out[i, h, 6] = out[i, h, 6] + c6 * A[6, 6] + c7 * A[7, 6]
            out[i, h, 7] = out[i, h, 7] + c7 * A[7, 7]
            for m in range(_PIXELS):
                out[i, s, m] = cross[i, s, m]
            out[i, s, 6] += c7 * of_target[h, s, 7, 6]
