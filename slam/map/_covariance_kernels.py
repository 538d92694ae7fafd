"""How well the observations of a point determine its position."""

import numpy as np
from numba import njit

from dslab.slam.optimization._cholesky import factor, solve, whole_rows


@njit(cache=True, nogil=True)
def refresh_covariance(m, point, view, distance):
    """Recompute a point's covariance: the inverse of the information of its observations.

    Before any, its position is known to a distance: along a ray without parallax that is what is left.
    """
    xx, yy, zz = 1.0 / distance**2, 1.0 / distance**2, 1.0 / distance**2
    xy, xz, yz = 0.0, 0.0, 0.0
    e = m.pt_head[point]
    while e >= 0:
        T = m.kf_T_cam_map[m.kp_keyframe[e]]
        w = view.inv_sigma2[m.kp_octave[e]]
        x, y, z = m.pt_xyz[point]
        z_cam = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        if z_cam > 1e-9:
            u = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / z_cam
            v = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / z_cam
            for f, q, row in ((view.fx, u, 0), (view.fy, v, 1)):
                a = f * (T[row, 0] - q * T[2, 0]) / z_cam
                b = f * (T[row, 1] - q * T[2, 1]) / z_cam
                c = f * (T[row, 2] - q * T[2, 2]) / z_cam
                xx += w * a * a
                xy += w * a * b
                xz += w * a * c
                yy += w * b * b
                yz += w * b * c
                zz += w * c * c
        e = m.kp_next[e]
    A, B, C = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    det = xx * A + xy * B + xz * C
    covariance = m.pt_covariance[point]
    covariance[0], covariance[1], covariance[2] = A / det, B / det, C / det
    covariance[3], covariance[4] = (xx * zz - xz * xz) / det, (xy * xz - xx * yz) / det
    covariance[5] = (xx * yy - xy * xy) / det


@njit(cache=True, nogil=True)
def relative_covariance(m, view, n_keyframes, keyframe, T_cam_map, points, octave, noise2, frame_noise2):
    """Covariance of a frame's pose relative to a keyframe, with the points and two more keyframes unknown.

    The keyframe is held, and the length of the longer baseline from it: how large the map is nobody knows.
    Points are eliminated by Schur's complement.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        n_keyframes: of the map.
        keyframe: row of the one it is relative to.
        T_cam_map: (4, 4) pose of the frame.
        points: (N,) int32 that it shows.
        octave: (N,) int32 of the keypoints that show them.
        noise2, frame_noise2: variances of the map's and the frame's keypoints over what the view says.

    Returns:
        (6, 6) of a twist from the left; infinite where it is not determined.
    """
    cameras = _sharing_most(m, n_keyframes, keyframe, points)
    free = 1 + (cameras[1] >= 0) + (cameras[2] >= 0)
    H = np.zeros((6 * free, 6 * free))
    Jc, Jp = np.empty((2, 6)), np.empty((2, 3))
    A, AV, W, V = np.empty((3, 6, 3)), np.empty((6, 3)), np.empty((3, 3)), np.empty((3, 3))
    seen = np.empty(3, np.int64)
    covariance = np.full((6, 6), np.inf)
    for i in range(len(points)):
        p = points[i]
        W[:] = 0.0
        n = np.int64(0)
        _jacobians(view, T_cam_map, m.pt_xyz[p], Jc, Jp)
        n = _observe(H, W, A, seen, n, np.int64(0), Jc, Jp, view.inv_sigma2[octave[i]] / frame_noise2)
        e = m.pt_head[p]
        while e >= 0:
            k = m.kp_keyframe[e]
            camera = np.int64(-1)
            if k == keyframe:
                camera = np.int64(3)  # held
            elif k == cameras[1]:
                camera = np.int64(1)
            elif k == cameras[2]:
                camera = np.int64(2)
            if camera > 0:
                _jacobians(view, m.kf_T_cam_map[k], m.pt_xyz[p], Jc, Jp)
                n = _observe(H, W, A, seen, n, camera, Jc, Jp, view.inv_sigma2[m.kp_octave[e]] / noise2)
            e = m.kp_next[e]
        least = 1e-12 * (W[0, 0] + W[1, 1] + W[2, 2])
        for r in range(3):
            W[r, r] += least
        _invert_3(W, V)
        for a in range(n):
            for r in range(6):
                for c in range(3):
                    AV[r, c] = A[a, r, 0] * V[0, c] + A[a, r, 1] * V[1, c] + A[a, r, 2] * V[2, c]
            for b in range(n):
                if seen[b] > seen[a]:
                    continue  # the lower triangle is enough
                for r in range(6):
                    for c in range(6):
                        H[6 * seen[a] + r, 6 * seen[b] + c] -= (
                            AV[r, 0] * A[b, c, 0] + AV[r, 1] * A[b, c, 1] + AV[r, 2] * A[b, c, 2]
                        )
    if not _hold_scale(m, H, keyframe, cameras):
        return covariance
    rows = whole_rows(np.int64(6 * free))
    if not factor(H, rows):
        return covariance
    column = np.empty(6 * free)
    for c in range(6):
        column[:] = 0.0
        column[c] = 1.0
        solve(H, rows, column)
        covariance[:, c] = column[:6]
    return 0.5 * (covariance + covariance.T)


@njit(cache=True, nogil=True)
def _sharing_most(m, n_keyframes, keyframe, points):
    """(3,) -1, and the two other keyframes that observe most of some points, -1 for none."""
    votes = np.zeros(n_keyframes, np.int64)
    for p in points:
        e = m.pt_head[p]
        while e >= 0:
            votes[m.kp_keyframe[e]] += 1
            e = m.kp_next[e]
    votes[keyframe] = 0
    found = np.full(3, -1)
    for place in range(1, 3):
        k = np.argmax(votes)
        if votes[k] > 0:
            found[place] = k
            votes[k] = 0
    return found


@njit(cache=True, nogil=True)
def _jacobians(view, T, xyz, Jc, Jp):
    """Write those of a pixel by a twist of the pose from the left (2, 6) and by the point (2, 3)."""
    z = max(T[2, 0] * xyz[0] + T[2, 1] * xyz[1] + T[2, 2] * xyz[2] + T[2, 3], 1e-9)
    x = (T[0, 0] * xyz[0] + T[0, 1] * xyz[1] + T[0, 2] * xyz[2] + T[0, 3]) / z
    y = (T[1, 0] * xyz[0] + T[1, 1] * xyz[1] + T[1, 2] * xyz[2] + T[1, 3]) / z
    fx, fy = view.fx, view.fy
    Jc[0, 0], Jc[0, 1], Jc[0, 2] = fx / z, 0.0, -fx * x / z
    Jc[1, 0], Jc[1, 1], Jc[1, 2] = 0.0, fy / z, -fy * y / z
    Jc[0, 3], Jc[0, 4], Jc[0, 5] = -fx * x * y, fx * (1.0 + x * x), -fx * y
    Jc[1, 3], Jc[1, 4], Jc[1, 5] = -fy * (1.0 + y * y), fy * x * y, fy * x
    for r in range(2):
        for c in range(3):
            Jp[r, c] = Jc[r, 0] * T[0, c] + Jc[r, 1] * T[1, c] + Jc[r, 2] * T[2, c]


@njit(cache=True, nogil=True)
def _observe(H, W, A, seen, n, camera, Jc, Jp, weight):
    """Add an observation to the information of its camera, unless that is held (3), and of its point."""
    for r in range(3):
        for c in range(3):
            W[r, c] += weight * (Jp[0, r] * Jp[0, c] + Jp[1, r] * Jp[1, c])
    if camera == 3:
        return n
    seen[n] = camera
    for r in range(6):
        for c in range(3):
            A[n, r, c] = weight * (Jc[0, r] * Jp[0, c] + Jc[1, r] * Jp[1, c])
        for c in range(6):
            H[6 * camera + r, 6 * camera + c] += weight * (Jc[0, r] * Jc[0, c] + Jc[1, r] * Jc[1, c])
    return n + 1


@njit(cache=True, nogil=True)
def _invert_3(W, V):
    """Write the inverse of a symmetric (3, 3)."""
    A, B = W[1, 1] * W[2, 2] - W[1, 2] ** 2, W[0, 2] * W[1, 2] - W[0, 1] * W[2, 2]
    C = W[0, 1] * W[1, 2] - W[0, 2] * W[1, 1]
    det = W[0, 0] * A + W[0, 1] * B + W[0, 2] * C
    V[0, 0], V[0, 1], V[0, 2] = A / det, B / det, C / det
    V[1, 1] = (W[0, 0] * W[2, 2] - W[0, 2] ** 2) / det
    V[1, 2] = (W[0, 1] * W[0, 2] - W[0, 0] * W[1, 2]) / det
    V[2, 2] = (W[0, 0] * W[1, 1] - W[0, 1] ** 2) / det
    V[1, 0], V[2, 0], V[2, 1] = V[0, 1], V[0, 2], V[1, 2]


@njit(cache=True, nogil=True)
def _hold_scale(m, H, keyframe, cameras):
    """Hold the longer baseline from the keyframe to a thousandth; False without any."""
    R, t = m.kf_T_cam_map[keyframe][:3, :3], m.kf_T_cam_map[keyframe][:3, 3]
    most, place, baseline = 0.0, 0, np.empty(3)
    for camera in range(1, 3):
        if cameras[camera] >= 0:
            T = m.kf_T_cam_map[cameras[camera]]
            apart = np.empty(3)
            for c in range(3):
                apart[c] = R[0, c] * t[0] + R[1, c] * t[1] + R[2, c] * t[2]
                apart[c] -= T[0, c] * T[0, 3] + T[1, c] * T[1, 3] + T[2, c] * T[2, 3]
            length = np.sqrt((apart**2).sum())
            if length > most:
                most, place, baseline = length, camera, apart
    if place == 0:
        return False
    T = m.kf_T_cam_map[cameras[place]]
    g = np.empty(3)
    for r in range(3):
        g[r] = (T[r, 0] * baseline[0] + T[r, 1] * baseline[1] + T[r, 2] * baseline[2]) / most
    for r in range(3):
        for c in range(3):
            H[6 * place + r, 6 * place + c] += g[r] * g[c] / (1e-3 * most) ** 2
    return True
