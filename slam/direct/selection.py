"""Selection of pixels whose intensity tells where they are, from an image alone.

A pixel is selected where its gradient stands out from its surroundings, so that faint regions have points
too: in a block where no pixel does, a coarser gradient over a larger block may.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.2. Ours: the second and third rounds
take the gradients of coarser levels, where noise has averaged out; a faint image halves the bound; medians
are interpolated between the centres of their regions, as the scene has no border where a region has one.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from dslab.slam.core.settings import setting, settings
from dslab.slam.direct._selection_kernels import region_medians, squared_gradients, strongest
from dslab.slam.direct.pyramid import ImagePyramid

_REGION_PX = 32
_LEVELS = (0, 1, 2)
_ROUNDS = 3
_LEAST_THRESHOLD = 1.0
_CLOSE = 1.25  # a number of points this near to the wanted one needs no other blocks


@settings
class SelectionConfig:
    """Settings of the selection of points."""

    points: int = setting(2000, "number of points wanted")
    margin_px: int = setting(4, "border without points")
    threshold: float = setting(
        7.0, "least gradient beyond its region's median, halved if need be", unit="grey levels per px"
    )
    coarser: float = setting(0.75, "factor of the threshold for every coarser gradient", le=1)


@dataclass(frozen=True)
class Selection:
    """Selected pixels.

    Attributes:
        xy: (N, 2) int32 pixels of the finest level.
        scale: (N,) int32 level of the pyramid on which the gradient stands out: 0, 1 or 2.
    """

    xy: np.ndarray
    scale: np.ndarray


def select(pyramid: ImagePyramid, config: SelectionConfig | None = None) -> Selection:
    """Select pixels, spread over the image; deterministic.

    The size of blocks is adapted to the number of points wanted. An image without gradients has none.
    """
    config = config or SelectionConfig()
    squares = [squared_gradients(level) for level in pyramid.levels[: len(_LEVELS)]]
    height, width = squares[0].shape
    threshold = config.threshold
    medians = cv2.resize(region_medians(squares[0], _REGION_PX), (width, height))
    found = _select(squares, (medians + threshold) ** 2, config)
    while len(found.xy) < config.points / 2 and threshold > _LEAST_THRESHOLD:
        threshold /= 2
        found = _select(squares, (medians + threshold) ** 2, config)
    return found


def _select(squares: list[np.ndarray], bounds: np.ndarray, config: SelectionConfig) -> Selection:
    """With blocks of such a size that there are about as many pixels as wanted."""
    block = max(1, round(np.sqrt(squares[0].size / max(1, config.points))))
    found = _selected(squares, bounds, block, config)
    for _ in range(_ROUNDS - 1):
        share = max(len(found.xy), 1) / config.points
        wanted = max(1, int(block * np.sqrt(share)))
        if 1 / _CLOSE < share < _CLOSE or wanted == block or not len(found.xy):
            break
        block = wanted
        found = _selected(squares, bounds, block, config)
    return _thinned(found, config.points)


def _selected(
    squares: list[np.ndarray], bounds: np.ndarray, block: int, config: SelectionConfig
) -> Selection:
    """One of every block, where its gradient stands out; elsewhere of larger blocks, by coarser levels."""
    height, width = bounds.shape
    taken = np.zeros((-(-height // block), -(-width // block)), bool)
    xy, scale = [], []
    for level in _LEVELS[: len(squares)]:
        if level:
            taken = _halved(taken)
        room = np.empty((taken.size, 2), np.int32)
        factor = config.coarser ** (2 * level)
        n = strongest(squares[level], level, bounds, factor, block << level, config.margin_px, taken, room)
        xy.append(room[:n])
        scale.append(np.full(n, level, np.int32))
    return Selection(np.concatenate(xy), np.concatenate(scale))


def _halved(taken: np.ndarray) -> np.ndarray:
    """Blocks of twice the side: true where one of their four is."""
    rows, columns = taken.shape
    padded = np.pad(taken, ((0, rows % 2), (0, columns % 2)))
    across = padded[:, ::2] | padded[:, 1::2]
    return across[::2] | across[1::2]


def _thinned(found: Selection, most: int) -> Selection:
    """Every so many of the points, if they are more than wanted."""
    if len(found.xy) <= most:
        return found
    kept = np.arange(most) * len(found.xy) // most
    return Selection(found.xy[kept], found.scale[kept])
