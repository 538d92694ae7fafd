"""How well the observations of a point determine its position."""

from numba import njit


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
