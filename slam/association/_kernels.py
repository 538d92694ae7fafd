"""Kernels of association: windows from covariances, and the posterior of every pair.

A point that is in view is seen by one keypoint at most. The odds that it is keypoint i, against that none of
the keypoints shows it, are

    P_D t(e_i; S) P(octave_i) P(d_i | it) / (λ P(d_i | other)) / (1 - P_D),

with the error e_i of the keypoint from the predicted pixel, its covariance S, the density λ of the keypoints
of its octave and the distance d_i of descriptors: probabilistic data association. Errors are of Student's t,
see ``slam.optimization.student``.

Source: Bar-Shalom, Daum, Huang, "The probabilistic data association filter", IEEE Control Systems Magazine
29(6), 2009, without its gate's probability, which is .99 here.
"""

import numpy as np
from numba import njit

from dslab.slam.features._hamming import hamming256
from dslab.slam.matching.projection import in_view, project
from dslab.slam.optimization.student import CHI2_99, density_at
from dslab.slam.optimization.uncertain_pose import SAME_SURFACE, of_point

OCTAVE_SPREAD = 1.0
"""Standard deviation of an octave about the predicted one: of rounding, and of the corner's own scale."""
_MIN_COSINE = 0.5
"""Between the direction of view and a point's mean one: Mur-Artal et al., 2015, V-D."""
_RATES = np.array([0.1, 0.3, 0.6, 1.0])
"""Shares of the points' own rates at which a view may find them: a smeared one finds few of all."""
CELLS = 8
"""To a row of the image: the points of a cell are of one surface."""


@njit(cache=True, nogil=True, error_model="numpy")
def density_of(octave, levels, area):
    """(levels,) keypoints per px² of every octave, of an image of so many px²; at least one in it."""
    count = np.ones(levels)
    for o in octave:
        count[o] += 1.0
    return count / area


@njit(cache=True, nogil=True, error_model="numpy")
def spread_of_pixel(view, T, xyz, point_covariance, noise2, pose_covariance, J):
    """Where a point is expected, and the covariance of that: (u, v, z, uu, uv, vv); z <= 0 behind the camera.

    Args:
        view: ViewGeometry.
        T: (4, 4) pose.
        xyz: (3,) point.
        point_covariance: (6,) of it at the noise that the view says, map frame.
        noise2: variance of the keypoints over that.
        pose_covariance: (6, 6) of a twist from the left.
        J: (2, 6) room for the derivatives by that, zeros at [0, 1] and [1, 0].
    """
    u, v, z = project(T, view, xyz)
    if z <= 0:
        return 0.0, 0.0, -1.0, 0.0, 0.0, 0.0
    x, y = (u - view.cx) / view.fx, (v - view.cy) / view.fy
    fu, fv = view.fx / z, view.fy / z
    uu, uv, vv = of_point(T, x, y, fu, fv, point_covariance)
    uu, uv, vv = noise2 * uu, noise2 * uv, noise2 * vv
    J[0, 0], J[0, 2], J[0, 3] = fu, -fu * x, -view.fx * x * y
    J[0, 4], J[0, 5] = view.fx * (1.0 + x * x), -view.fx * y
    J[1, 1], J[1, 2], J[1, 3] = fv, -fv * y, -view.fy * (1.0 + y * y)
    J[1, 4], J[1, 5] = view.fy * x * y, view.fy * x
    for r in range(6):
        a, b = 0.0, 0.0
        for c in range(6):
            a += pose_covariance[r, c] * J[0, c]
            b += pose_covariance[r, c] * J[1, c]
        uu += J[0, r] * a
        uv += J[0, r] * b
        vv += J[1, r] * b
    return u, v, z, uu, uv, vv


@njit(cache=True, nogil=True, error_model="numpy")
def camera_at(T):
    """(3,) centre of a camera of a pose (4, 4)."""
    centre = np.zeros(3)
    for r in range(3):
        for c in range(3):
            centre[c] -= T[r, c] * T[r, 3]
    return centre


@njit(cache=True, nogil=True, error_model="numpy")
def expected_view(view, T, centre, xyz, normal, max_distance):
    """Where a view should show a point, and on which level: (u, v, octave); the octave NaN if it should not.

    Args:
        view: ViewGeometry.
        T: (4, 4) pose.
        centre: (3,) of the camera, map frame.
        xyz: (3,) point.
        normal: (3,) mean direction from which it was seen.
        max_distance: at which it is on level 0.
    """
    u, v, z = project(T, view, xyz)
    if z <= 0 or not in_view(view, u, v):
        return 0.0, 0.0, np.nan
    dx, dy, dz = xyz[0] - centre[0], xyz[1] - centre[1], xyz[2] - centre[2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    octave = np.log(max_distance / distance) / view.log_scale
    turned = dx * normal[0] + dy * normal[1] + dz * normal[2] < _MIN_COSINE * distance
    if turned or abs(octave - 0.5 * (len(view.scale) - 1)) > 0.5 * len(view.scale) + OCTAVE_SPREAD:
        return 0.0, 0.0, np.nan
    return u, v, octave


@njit(cache=True, nogil=True, error_model="numpy")
def detection(found, visible):
    """Chance that a point is detected where it is, by how often it was; before that four of five are."""
    return min((found + 4.0) / (visible + 5.0), 0.99)


@njit(cache=True, nogil=True, error_model="numpy")
def of_octave(apart):
    """Density of an octave about the one that is expected."""
    return 0.3989 / OCTAVE_SPREAD * np.exp(-0.5 * (apart / OCTAVE_SPREAD) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def likeliest(
    view, xy, octave, descriptors, cell_start, first, u, v, uu, uv, vv, noise2, level, density, detected,
    query, odds,
):  # fmt: skip
    """The keypoint that most likely shows a point, and the odds of it against all else.

    Args:
        view: ViewGeometry.
        xy, octave, descriptors, cell_start: keypoints; the frame's rows start at ``first``.
        first: see there.
        u, v: predicted pixel.
        uu, uv, vv: its covariance, px², without the keypoint's noise.
        noise2: variance of a keypoint over what the view says.
        level: predicted octave, a fraction.
        density: (levels,) keypoints per px² of every octave.
        detected: chance that the point is detected where it is.
        query: (4,) uint64 its descriptor.
        odds: (257,) by distance of descriptors.

    Returns:
        (row within the frame, -1 for none; posterior that it shows the point; area of its window, px²; sum
        of the odds of all keypoints).
    """
    nearest = min(max(int(level + 0.5), 0), len(view.scale) - 1)
    own = noise2 / view.inv_sigma2[nearest]
    half_u, half_v = np.sqrt(CHI2_99 * (uu + own)), np.sqrt(CHI2_99 * (vv + own))
    c0 = max(int((u - half_u - view.x_min) / view.cell), 0)
    c1 = min(int((u + half_u - view.x_min) / view.cell), view.cols - 1)
    r0 = max(int((v - half_v - view.y_min) / view.cell), 0)
    r1 = min(int((v + half_v - view.y_min) / view.cell), view.rows - 1)
    total, best, found, found_area = 1.0 - detected, 0.0, -1, 0.0
    if c0 > c1 or r0 > r1:
        return -1, 0.0, 0.0, 0.0
    for r in range(r0, r1 + 1):
        for i in range(cell_start[r * view.cols + c0], cell_start[r * view.cols + c1 + 1]):
            e = first + i
            apart = octave[e] - level
            if abs(apart) > 3.0 * OCTAVE_SPREAD:
                continue
            du, dv = xy[e, 0] - u, xy[e, 1] - v
            if abs(du) > half_u or abs(dv) > half_v:
                continue
            noise = noise2 / view.inv_sigma2[octave[e]]
            a, c = uu + noise, vv + noise
            det = a * c - uv * uv
            chi2 = (c * du * du - 2.0 * uv * du * dv + a * dv * dv) / det
            if chi2 > CHI2_99:
                continue
            likely = detected * density_at(chi2, det) * of_octave(apart) / density[octave[e]]
            likely *= odds[hamming256(query, descriptors[e])]
            total += likely
            if likely > best:
                best, found, found_area = likely, i, np.pi * CHI2_99 * np.sqrt(det)
    return found, best / total, found_area, total - (1.0 - detected)


@njit(cache=True, nogil=True, error_model="numpy")
def associate(
    m, view, T_cam_map, pose_covariance, noise2, candidates, xy, octave, descriptors, cell_start, density,
    odds, least, observing,
):  # fmt: skip
    """Find points of the map in a frame.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        T_cam_map: (4, 4) predicted pose.
        pose_covariance: (6, 6) of a twist from the left.
        noise2: variance of the keypoints over what the view says.
        candidates: (Q,) int32 points.
        xy, octave, descriptors, cell_start: the frame.
        density: (levels,) keypoints per px² of every octave.
        odds: (257,) by distance of descriptors.
        least: posterior from which a pair is taken.
        observing: count the points in view as visible.

    Returns:
        point (N,) int32 per keypoint, -1 for none; area (N,) of the window in which it was found, px²; log
        of the odds that the view is here, against anywhere else, from all points that it should show.
    """
    n = len(octave)
    side = (view.x_max - view.x_min) / CELLS
    cells = CELLS * (int((view.y_max - view.y_min) / side) + 1)
    told, product, count = np.zeros((cells, len(_RATES))), np.ones((cells, len(_RATES))), np.zeros(cells)
    point = np.full(n, -1, np.int32)
    area = np.zeros(n)
    held = np.zeros(n)
    centre, J = camera_at(T_cam_map), np.zeros((2, 6))
    for p in candidates:
        if p < 0 or m.pt_bad[p]:
            continue
        u, v, level = expected_view(
            view, T_cam_map, centre, m.pt_xyz[p], m.pt_normal[p], m.pt_max_distance[p]
        )
        if np.isnan(level):
            continue
        m.pt_visible[p] += observing
        u, v, _, uu, uv, vv = spread_of_pixel(
            view, T_cam_map, m.pt_xyz[p], m.pt_covariance[p], noise2, pose_covariance, J
        )
        detected = detection(m.pt_found[p], m.pt_visible[p])
        i, posterior, window, shown = likeliest(
            view, xy, octave, descriptors, cell_start, np.int64(0), u, v, uu, uv, vv, noise2, level, density,
            detected, m.pt_descriptor[p], odds,
        )  # fmt: skip
        cell = int((v - view.y_min) / side) * CELLS + min(int((u - view.x_min) / side), CELLS - 1)
        count[cell] += 1.0
        for r in range(len(_RATES)):
            product[cell, r] *= 1.0 + _RATES[r] * (shown - detected)
            if not 1e-100 < product[cell, r] < 1e100:
                told[cell, r] += np.log(product[cell, r])
                product[cell, r] = 1.0
        if i >= 0 and posterior >= least and posterior > held[i]:
            point[i], area[i], held[i] = p, window, posterior
    return point, area, _evidence(told + np.log(product), count)


@njit(cache=True, nogil=True, error_model="numpy")
def _evidence(told, count):
    """Log of the odds of a view, from those of the points in its cells (cells, rates) at every rate.

    Of the n points of a cell, which are of one surface, each counts 1 / (1 + (n - 1) ρ).
    """
    of_rate = np.zeros(told.shape[1])
    for c in range(len(count)):
        if count[c] > 0:
            of_rate += told[c] / (1.0 + (count[c] - 1.0) * SAME_SURFACE)
    most = of_rate.max()
    return most + np.log(np.mean(np.exp(of_rate - most)))


@njit(cache=True, nogil=True, error_model="numpy")
def matches_of(m, view, point, xy, octave, area, image, noise2):
    """Gather what the matches of a frame say of its pose.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        point: (N,) int32 point per keypoint, -1 for none.
        xy, octave, area: keypoints, and the window in which each was found, px², 0 for the whole image.
        image: its area, px².
        noise2: variance of the keypoints over what the view says.

    Returns:
        Of n matches: rows (n,), points (n, 3), their covariances (n, 6), pixels (n, 2), information of each
        (n,), 1/px², and areas (n,); the median variance of the predictions in the image that these tell.
    """
    n = (point >= 0).sum()
    rows = np.empty(n, np.int64)
    xyz, covariance, pixels = np.empty((n, 3)), np.empty((n, 6)), np.empty((n, 2))
    information, areas, spread = np.empty(n), np.empty(n), np.empty(n)
    k = 0
    for i in range(len(point)):
        p = point[i]
        if p < 0:
            continue
        rows[k], information[k] = i, view.inv_sigma2[octave[i]]
        xyz[k], covariance[k], pixels[k] = m.pt_xyz[p], m.pt_covariance[p], xy[i]
        areas[k] = area[i] if area[i] > 0 else image
        spread[k] = max(areas[k] / (np.pi * CHI2_99) - noise2 / information[k], 0.0)
        k += 1
    return rows, xyz, covariance, pixels, information, areas, np.median(spread) if n else 0.0
