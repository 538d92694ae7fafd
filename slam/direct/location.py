"""Where single points of a reference are seen in another view, whose motion is known."""

import numpy as np

from dslab.slam.direct._alignment_kernels import PATTERN, sample_patterns
from dslab.slam.direct._location_kernels import locate, search_line
from dslab.slam.direct.alignment import Aligned, Reference
from dslab.slam.direct.pyramid import ImagePyramid

_NEAREST, _FARTHEST = 0.25, 20.0  # depths that are searched, of the usual one
_GRADIENT_SCALE = 50.0


def locate_points(
    reference: Reference, target: ImagePyramid, found: Aligned
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels at which points of known depth are seen, shifted across their edges to where they fit best.

    Returns:
        (N, 2) pixels of the finest level, NaN where not seen; (N,) mean absolute residual there, of 255.
    """
    p = reference.levels[0]
    xy, error = np.empty_like(p.uv), np.empty(len(p.uv))
    locate(
        target.levels[0], reference.intrinsics[0], p.uv, p.inverse_depth, PATTERN, p.intensity, p.weight,
        found.T_target_ref, found.affine, xy, error,
    )  # fmt: skip
    return xy, error


def locate_on_lines(
    source: ImagePyramid,
    target: ImagePyramid,
    intrinsics: np.ndarray,
    xy: np.ndarray,
    found: Aligned,
    depth: float,
    most_px: float,
    most_error: float,
    distinct: float,
) -> np.ndarray:
    """Pixels at which points of unknown depth are seen, searched along their epipolar lines.

    Args:
        source, target: the two views.
        intrinsics: (4,) of the finest level.
        xy: (N, 2) pixels of the source.
        found: alignment, source to target.
        depth: usual depth of points in the source; they are searched from a quarter to twenty times of it.
        most_px: longest line that is searched.
        most_error: mean absolute residual beyond which nothing is found.
        distinct: least residual of the second best place over the best.

    Returns:
        (N, 2) pixels of the target, NaN where nothing is found.
    """
    uv = np.ascontiguousarray(xy, float)
    at, error = np.full(uv.shape, np.nan), np.empty(len(uv))
    if depth <= 0 or not len(uv):
        return at
    intensity, weight = np.empty((len(uv), len(PATTERN))), np.empty((len(uv), len(PATTERN)))
    sample_patterns(source.levels[0], uv, PATTERN, _GRADIENT_SCALE, intensity, weight)
    search_line(
        target.levels[0], intrinsics, uv, PATTERN, intensity, weight, found.T_target_ref, found.affine,
        1 / (_NEAREST * depth), 1 / (_FARTHEST * depth), most_px, most_error, distinct, at, error,
    )  # fmt: skip
    return at
