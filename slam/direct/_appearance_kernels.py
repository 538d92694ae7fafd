"""Kernel that compares patches of one view with another view in which they should be seen."""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import _bilinear


@njit(cache=True, nogil=True)
def correlations(
    level, camera, uv, inverse_depth, pattern, intensity, T, offsets, reach, least_contrast, best
):  # fmt: skip
    """Write how well each patch correlates with what the other view shows where it should be, and beside it.

    Names as for alignment. A patch is warped as the motion says, and shifted by whole pixels up to ``reach``
    to where it fits best.

    Args:
        level: (H, W, 3) of the other view.
        intensity: (N, k) of the patches' pixels.
        offsets: (m, 2) places beside the expected one at which the same is done, px.
        reach: shifts tried in x and y about each place, px.
        least_contrast: standard deviation of a patch below which it tells nothing.
        best: (N, m) largest correlation at each place, -1 to 1; NaN where it cannot be told.
    """
    height, width = level.shape[0], level.shape[1]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    count = pattern.shape[0]
    at = np.empty((count, 2))
    least = count * least_contrast * least_contrast
    best[:] = np.nan
    for i in range(uv.shape[0]):
        d, mean, seen = inverse_depth[i], 0.0, True
        for k in range(count):
            x = (uv[i, 0] + pattern[k, 0] - cx) / fx
            y = (uv[i, 1] + pattern[k, 1] - cy) / fy
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * d
            if pz <= 1e-6:
                seen = False
                break
            at[k, 0] = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * d) / pz + cx
            at[k, 1] = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * d) / pz + cy
            mean += intensity[i, k] / count
        if not seen:
            continue
        own = 0.0
        for k in range(count):
            own += (intensity[i, k] - mean) ** 2
        if not own >= least:  # or NaN
            continue
        for m in range(offsets.shape[0]):
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    right, down = offsets[m, 0] + dx, offsets[m, 1] + dy
                    s1, s2, both, inside = 0.0, 0.0, 0.0, True
                    for k in range(count):
                        u, v = at[k, 0] + right, at[k, 1] + down
                        if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
                            inside = False
                            break
                        value = _bilinear(level, u, v, 0)
                        s1 += value
                        s2 += value * value
                        both += value * (intensity[i, k] - mean)
                    if not inside:
                        continue
                    others = s2 - s1 * s1 / count
                    if not others >= 0.0:  # NaN
                        continue
                    c = both / np.sqrt(own * others) if others >= least else 0.0
                    if not best[i, m] >= c:
                        best[i, m] = c
