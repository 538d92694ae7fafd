"""Selection of pixels whose intensity tells where they are, from an image alone.

A pixel is selected where its gradient stands out from its surroundings, so that faint regions have points
too: in a block where no pixel does, a coarser gradient over a larger block may.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.1.
Where it says less, this follows the authors' public code step by step.
"""

from dataclasses import dataclass, replace

import numpy as np

from dslab.slam.core.settings import setting, settings
from dslab.slam.direct._selection_kernels import select_in_blocks, squared_gradients, thresholds
from dslab.slam.direct.pyramid import ImagePyramid

_REGION_PX = 32
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
        xy: (N, 2) int32 pixels of the finest level, row by row of blocks.
        scale: (N,) int32 level of the pyramid on which the gradient stands out: 0, 1 or 2.
    """

    xy: np.ndarray
    scale: np.ndarray


def select(pyramid: ImagePyramid, config: SelectionConfig | None = None) -> Selection:
    """Select pixels, spread over the image; deterministic.

    The size of blocks is adapted to the number of points wanted. An image without gradients has none.
    """
    config = config or SelectionConfig()
    found = _select(pyramid, config)
    while len(found.xy) < config.points / 2 and config.threshold > _LEAST_THRESHOLD:
        config = replace(config, threshold=config.threshold / 2)
        found = _select(pyramid, config)
    return found


def _select(pyramid: ImagePyramid, config: SelectionConfig) -> Selection:
    squares = [squared_gradients(level) for level in pyramid.levels[:3]]
    while len(squares) < 3:
        squares.append(np.zeros((1, 1), np.float32))
    bounds = thresholds(squares[0], _REGION_PX, config.threshold)
    height, width = squares[0].shape
    block = max(1, round(np.sqrt(height * width / max(1, config.points))))
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
    xy, scale = select_in_blocks(
        squares[0], squares[1], squares[2], bounds, _REGION_PX, block, config.margin_px, config.coarser
    )
    return Selection(xy, scale)


def _thinned(found: Selection, most: int) -> Selection:
    """Every so many of the points, if they are more than wanted."""
    if len(found.xy) <= most:
        return found
    kept = np.arange(most) * len(found.xy) // most
    return Selection(found.xy[kept], found.scale[kept])
