"""Alignment of a sharp view with one that is blurred by motion: the sharper one is blurred too."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from dslab.slam.direct._blur_kernels import line_of_light
from dslab.slam.direct.alignment import Aligned, Reference, align
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier

_LENGTHS = tuple(2.0 * 1.4**i for i in range(13))  # px of the second finest level, on which this is done
_MOST_OF_WIDTH = 0.4
_LEAST_FLOW_PX = 0.5


def align_through_blur(
    reference: Reference,
    source: ImagePyramid,
    target: ImagePyramid,
    rectifier: Rectifier,
    xyz: np.ndarray,
    velocity: np.ndarray,
    guesses: Sequence[np.ndarray],
) -> Aligned | None:
    """Align two views, the sharper of them blurred along the predicted motion by the length that fits best.

    The whole image is blurred alike, on the second finest level: so much and no more does it tell.

    Args:
        reference: points of the source.
        source, target: the views.
        rectifier: that made them.
        xyz: (N, 3) the reference's points in its camera.
        velocity: (4, 4) motion per frame, earlier camera to later one.
        guesses: (4, 4) motions, source to target.

    Returns:
        The alignment of least error; None if there is none or nothing moves in the image.
    """
    if len(target) < 2:
        return None
    direction = _flow(xyz, velocity, reference.intrinsics[1])
    if direction is None:
        return None
    view, images = reference.coarser(), (source.levels[1][..., 0], target.levels[1][..., 0])
    blur_target = sharpness(target) > sharpness(source)

    def aligned(length: float) -> Aligned | None:
        blurred = rectifier.pyramid_of(_blurred(images[blur_target], direction, length), 1)
        if blur_target:
            return align(view, blurred, guesses)
        return align(view.seen_in(blurred), ImagePyramid(target.levels[1:]), guesses)

    return _least_error(aligned, [x for x in _LENGTHS if x <= _MOST_OF_WIDTH * images[0].shape[1]])


def _least_error(aligned: Callable[[float], Aligned | None], lengths: Sequence[float]) -> Aligned | None:
    """The alignment of least error: over every third length, then over those beside the best of them."""
    found = {i: aligned(lengths[i]) for i in range(1, len(lengths), 3)}
    errors = {i: each.error for i, each in found.items() if each is not None}
    if not errors:
        return None
    best = min(errors, key=errors.__getitem__)
    beside = [aligned(lengths[i]) for i in (best - 1, best + 1) if i < len(lengths)]
    return min((each for each in (found[best], *beside) if each is not None), key=lambda each: each.error)


def _flow(xyz: np.ndarray, velocity: np.ndarray, intrinsics: np.ndarray) -> np.ndarray | None:
    """(2,) direction in which points move in the image; None if they hardly do."""
    moved = xyz @ velocity[:3, :3].T + velocity[:3, 3]
    ahead = moved[:, 2] > 0
    if not ahead.any():
        return None
    flow = np.median(moved[ahead, :2] / moved[ahead, 2:] - xyz[ahead, :2] / xyz[ahead, 2:], axis=0)
    flow *= intrinsics[:2]
    speed_px = float(np.linalg.norm(flow))
    return flow / speed_px if speed_px >= _LEAST_FLOW_PX else None


def sharpness(pyramid: ImagePyramid) -> float:
    """Mean absolute gradient of the second finest level."""
    return float(np.nanmean(np.abs(pyramid.levels[1][..., 1:])))


def _blurred(image: np.ndarray, direction: np.ndarray, length: float) -> np.ndarray:
    """The image (H, W) float32 averaged along a line; what is unknown stays so."""
    size = int(np.ceil(length)) | 1
    kernel = line_of_light(direction, np.linspace(-length / 2, length / 2, 4 * size), size)
    kernel /= kernel.sum()
    known = np.isfinite(image)
    filled = np.where(known, image, np.float32(0))
    out = cv2.filter2D(filled, -1, kernel, borderType=cv2.BORDER_REPLICATE)
    if known.all():
        return out
    weight = cv2.filter2D(known.astype(np.float32), -1, kernel, borderType=cv2.BORDER_REPLICATE)
    return np.where(known, out / np.maximum(weight, 1e-6), np.float32(np.nan)).astype(np.float32)
