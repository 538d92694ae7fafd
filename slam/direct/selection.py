"""Selection of pixels whose intensity tells where they are, from an image alone.

A pixel is selected where its gradient stands out from its surroundings, so that faint regions have points
too: in a block where no pixel does, a coarser gradient over a larger block may.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.2. Ours: the second and third rounds
take the gradients of coarser levels, where noise has averaged out; and a faint image halves the bound.
"""

from dataclasses import dataclass

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
    medians, threshold = region_medians(squares[0], _REGION_PX), config.threshold
    found = _select(squares, medians + threshold, config)
    while len(found.xy) < config.points / 2 and threshold > _LEAST_THRESHOLD:
        threshold /= 2
        found = _select(squares, medians + threshold, config)
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
    taken = np.zeros(squares[0].shape, bool)
    xy, scale = [], []
    for level in _LEVELS[: len(squares)]:
        side = block << level
        room = np.empty((-(-taken.shape[0] // side) * -(-taken.shape[1] // side), 2), np.int32)
        at_level = (bounds * config.coarser**level).astype(np.float32)
        n = strongest(squares[level], level, at_level, _REGION_PX, side, config.margin_px, taken, room)
        xy.append(room[:n])
        scale.append(np.full(n, level, np.int32))
    return Selection(np.concatenate(xy), np.concatenate(scale))


def _thinned(found: Selection, most: int) -> Selection:
    """Every so many of the points, if they are more than wanted."""
    if len(found.xy) <= most:
        return found
    kept = np.arange(most) * len(found.xy) // most
    return Selection(found.xy[kept], found.scale[kept])
