"""Sprites with soft outlines, drawn over frames."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

_CUTS = 3
_ACTING_SHARE = 0.1  # of the view


@dataclass(frozen=True)
class Sprite:
    """Images of one object in several poses.

    Attributes:
        gray: (P, h, w) uint8.
        alpha: (P, h, w) uint8, 255 on the object, 0 beside it, in between on its outline.
    """

    gray: np.ndarray
    alpha: np.ndarray


def smooth_outline(corners: np.ndarray) -> np.ndarray:
    """(M, 2) closed outline with the (N, 2) corners rounded. Source: Chaikin, 1974."""
    for _ in range(_CUTS):
        after = np.roll(corners, -1, axis=0)
        corners = np.stack([0.75 * corners + 0.25 * after, 0.25 * corners + 0.75 * after], 1).reshape(-1, 2)
    return corners


def filled(size: tuple[int, int], outline: np.ndarray) -> np.ndarray:
    """(h, w) float32 cover, 0 to 1, of a closed outline in pixels, with a soft rim."""
    cover = np.zeros(size, np.uint8)
    points = np.rint(outline * 16).astype(np.int32)
    cv2.fillPoly(cover, [points], 255, cv2.LINE_AA, 4)
    return cover.astype(np.float32) / 255


def fill_share(share: float, draw_next: Callable[[], float], most: int) -> np.ndarray:
    """Draw one object after the other until they fill a share of the view.

    Args:
        share: of the view, 0 to 1.
        draw_next: draws the next one; returns the share that all fill by then.
        most: largest number of objects.

    Returns:
        (n + 1,) shares that the first 0, 1, 2 ... fill together.
    """
    shares = [0.0]
    while shares[-1] < share and len(shares) <= most:
        shares.append(draw_next())
    return np.array(shares)


def acting_share(share: float) -> float:
    """Threshold of a view share: a tenth, or half of a smaller share."""
    return min(_ACTING_SHARE, share / 2)


@njit(cache=True, nogil=True, error_model="numpy")
def draw_behind(gray, alpha, left, top, scale, light, open_share):
    """Draw a sprite behind everything drawn so far; it wraps around at the side borders.

    Args:
        gray, alpha: (h, w) uint8.
        left, top: float64 position of its upper left corner, pixels of the frame.
        scale: float64 pixels of the frame per pixel of the sprite.
        light: (H, W) float32 gray levels drawn so far, weighted by their cover; added to.
        open_share: (H, W) float32 share of each pixel that is still free; multiplied.
    """
    height, width = light.shape
    rows, columns = gray.shape
    span = int(np.ceil(columns * scale)) + 1
    begin = int(np.floor(left))
    # A sprite wider than the view leaves it wholly before it returns.
    period = max(width, span)
    for row in range(max(0, int(np.floor(top))), min(height - 1, int(top + rows * scale) + 1) + 1):
        y = (row - top) / scale
        if y < 0 or y > rows - 1.001:
            continue
        upper, down = int(y), np.float32(y - int(y))
        for step in range(span):
            column = (begin + step) % period
            x = (begin + step - left) / scale
            if column >= width or x < 0 or x > columns - 1.001:
                continue
            if open_share[row, column] < np.float32(0.004):
                continue
            near, right = int(x), np.float32(x - int(x))
            cover = _mixed(alpha, upper, near, down, right) / np.float32(255)
            if cover > 0:
                shown = open_share[row, column] * cover
                light[row, column] += shown * _mixed(gray, upper, near, down, right)
                open_share[row, column] -= shown


@njit(cache=True, nogil=True, inline="always")
def _mixed(image, row, column, down, right):
    one = np.float32(1)
    upper = (one - right) * image[row, column] + right * image[row, column + 1]
    lower = (one - right) * image[row + 1, column] + right * image[row + 1, column + 1]
    return (one - down) * upper + down * lower
