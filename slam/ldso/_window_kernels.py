"""Kernel of the photometric bundle adjustment: all residuals of a window with their Gauss-Newton model.

A residual is the pattern of a point in one keyframe beside its host. Its eight pixels share the geometric
part of their Jacobian, that of the point itself, taken at the first estimates of the poses.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.2 and 2.3.
"""

import numpy as np
from numba import njit

from slam.direct._alignment_kernels import _bilinear


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _project(M, right, down, u, v, d, fx, fy, cx, cy, seen_u, seen_v, depth):
    """Write where the pixels of a pattern are seen, and at what depth.

    It has no branches, so that it is vectorised; what is behind the camera means nothing.
    """
    M_00, M_01, M_02, M_03 = M[0, 0], M[0, 1], M[0, 2], M[0, 3]
    M_10, M_11, M_12, M_13 = M[1, 0], M[1, 1], M[1, 2], M[1, 3]
    M_20, M_21, M_22, M_23 = M[2, 0], M[2, 1], M[2, 2], M[2, 3]
    for k in range(np.uint64(len(right))):
        x, y = (u + right[k] - cx) / fx, (v + down[k] - cy) / fy
        z = M_20 * x + M_21 * y + M_22 + M_23 * d
        depth[k] = z
        seen_u[k] = fx * (M_00 * x + M_01 * y + M_02 + M_03 * d) / z + cx
        seen_v[k] = fy * (M_10 * x + M_11 * y + M_12 + M_13 * d) / z + cy


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
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    right, down = pattern[:, 0].copy(), pattern[:, 1].copy()
    count = np.uint64(len(right))
    seen_u, seen_v, depth = np.empty(len(right)), np.empty(len(right)), np.empty(len(right))
    gains = np.exp(affine[..., 0])
    information[:], gradient[:], cross[:] = 0.0, 0.0, 0.0
    H[:], b[:], total[:] = 0.0, 0.0, 0.0
    J, depth_J = np.empty((2, 6)), np.empty(2)
    # Unsigned: Numba need not look whether they count from the end.
    for i in range(np.uint64(host.shape[0])):
        h, d = np.uint64(host[i]), inverse_depth[i]
        for s in range(np.uint64(S)):
            energy[i, s], seen[i, s] = 0.0, -1
            if not taken[i, s] or s == h:
                continue
            M, F = T[h, s], T_first[h, s]
            x, y = (uv[i, 0] - cx) / fx, (uv[i, 1] - cy) / fy
            z = F[2, 0] * x + F[2, 1] * y + F[2, 2] + F[2, 3] * d
            if z <= 1e-6:
                continue
            px = (F[0, 0] * x + F[0, 1] * y + F[0, 2] + F[0, 3] * d) / z
            py = (F[1, 0] * x + F[1, 1] * y + F[1, 2] + F[1, 3] * d) / z
            gain, offset = gains[h, s], affine[h, s, 1]
            _project(M, right, down, uv[i, 0], uv[i, 1], d, fx, fy, cx, cy, seen_u, seen_v, depth)
            level = images[s]
            # Sums over the pattern: image gradient g, brightness (-gain I, -1), residual r.
            gxx, gxy, gyy, gxa, gya, gxb, gyb = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            aa, ab, bb, gxr, gyr, ar, br, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            inside = True
            for k in range(count):
                u, v = seen_u[k], seen_v[k]
                if depth[k] <= 1e-6 or not (1.0 <= u < width - 2 and 1.0 <= v < height - 2):
                    inside = False
                    break
                predicted = gain * intensity[i, k]
                r = _bilinear(level, u, v, 0) - predicted - offset
                gx, gy = _bilinear(level, u, v, 1), _bilinear(level, u, v, 2)
                if not abs(r) + abs(gx) + abs(gy) < np.inf:
                    inside = False
                    break
                size = abs(r)
                w = weight[i, k]
                cost += w * (size * size if size <= huber else huber * (2.0 * size - huber))
                w *= 1.0 if size <= huber else huber / size
                gxx += w * gx * gx
                gxy += w * gx * gy
                gyy += w * gy * gy
                gxa -= w * gx * predicted
                gya -= w * gy * predicted
                gxb -= w * gx
                gyb -= w * gy
                aa += w * predicted * predicted
                ab += w * predicted
                bb += w
                gxr += w * gx * r
                gyr += w * gy * r
                ar -= w * predicted * r
                br -= w * r
            if not inside:
                continue
            bound = max(outlier[h], outlier[s])
            if cost > bound:
                energy[i, s], seen[i, s] = bound, 0
                total[h, s] += bound
                continue
            energy[i, s], seen[i, s] = cost, 1
            total[h, s] += cost
            if sums.shape[0]:
                sums[i, s, 0], sums[i, s, 1], sums[i, s, 2] = gxx, gxy, gyy
                sums[i, s, 3], sums[i, s, 4], sums[i, s, 5], sums[i, s, 6] = gxa, gya, gxb, gyb
                sums[i, s, 7], sums[i, s, 8] = gxr, gyr
            near = d / z
            J[0, 0], J[0, 1], J[0, 2] = fx * near, 0.0, -fx * near * px
            J[0, 3], J[0, 4], J[0, 5] = -fx * px * py, fx * (1.0 + px * px), -fx * py
            J[1, 0], J[1, 1], J[1, 2] = 0.0, fy * near, -fy * near * py
            J[1, 3], J[1, 4], J[1, 5] = -fy * (1.0 + py * py), fy * px * py, fy * px
            depth_J[0] = fx * (F[0, 3] - px * F[2, 3]) / z
            depth_J[1] = fy * (F[1, 3] - py * F[2, 3]) / z
            A, c, link = H[h, s], b[h, s], cross[i, s]
            sx, sy = gxx * depth_J[0] + gxy * depth_J[1], gxy * depth_J[0] + gyy * depth_J[1]
            information[i] += sx * depth_J[0] + sy * depth_J[1]
            gradient[i] += gxr * depth_J[0] + gyr * depth_J[1]
            link[6] = gxa * depth_J[0] + gya * depth_J[1]
            link[7] = gxb * depth_J[0] + gyb * depth_J[1]
            for m in range(6):
                link[m] = sx * J[0, m] + sy * J[1, m]
                c[m] += gxr * J[0, m] + gyr * J[1, m]
                qx, qy = gxx * J[0, m] + gxy * J[1, m], gxy * J[0, m] + gyy * J[1, m]
                for n in range(m, 6):
                    A[m, n] += qx * J[0, n] + qy * J[1, n]
                A[m, 6] += gxa * J[0, m] + gya * J[1, m]
                A[m, 7] += gxb * J[0, m] + gyb * J[1, m]
            A[6, 6] += aa
            A[6, 7] += ab
            A[7, 7] += bb
            c[6] += ar
            c[7] += br
    for h in range(S):
        for s in range(S):
            for m in range(8):
                for n in range(m):
                    H[h, s, m, n] = H[h, s, n, m]


@njit(cache=True, nogil=True)
def to_keyframes(host, cross, of_host, of_target, out):
    """Write the terms of inverse depths and pairs, (N, S, 8), as terms with keyframes, out (N, S, 8).

    Args:
        host: (N,) rows.
        cross: (N, S, 8) as of :func:`linearise_window`.
        of_host, of_target: (S, S, 8, 8) derivatives of a pair's parameters by those of its keyframes.
    """
    out[:] = 0.0
    for i in range(host.shape[0]):
        h = host[i]
        for s in range(cross.shape[1]):
            if cross[i, s, 7] == 0.0 and cross[i, s, 0] == 0.0 and cross[i, s, 6] == 0.0:
                continue
            A, B = of_host[h, s], of_target[h, s]
            for m in range(8):
                c = cross[i, s, m]
                for n in range(8):
                    out[i, h, n] += c * A[m, n]
                    out[i, s, n] += c * B[m, n]
