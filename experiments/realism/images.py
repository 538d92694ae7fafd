"""Statistics of single frames."""

import cv2
import numpy as np

_EVEN_SHARE = 0.05  # of the tiles, the most even ones, in which noise is measured
_NOISE_TILE_PX = 16
_LEAST_CORNER = 7
_CLEAR_CORNER = 20
_TILES_ACROSS = 8
_DARK, _BRIGHT = 5, 250


def frame_statistics(image: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the measures of group ``images``.

    Args:
        image: (H, W) uint8 grey frame.

    Returns:
        (n,) float64 each, by the measure's name; empty where a frame has nothing to measure.
    """
    corners = cv2.FastFeatureDetector_create(_LEAST_CORNER, True).detect(image)
    strength = np.array([c.response for c in corners], float)
    places = np.array([c.pt for c in corners], float).reshape(-1, 2)
    dark, bright = np.mean(image <= _DARK), np.mean(image >= _BRIGHT)
    return {
        "noise": noise_levels(image),
        "sharpness": _sharpness(image),
        "clipped_dark": np.array([dark]),
        "clipped_bright": np.array([bright]),
        "corner_strength": strength,
        "empty_tiles": np.array([_empty_tiles(image.shape, places[strength > _CLEAR_CORNER])]),
    }


def noise_levels(image: np.ndarray) -> np.ndarray:
    """(0,) or (1,) noise of a frame, grey levels, from its most even tiles that are not clipped.

    Source: Immerkaer, "Fast noise variance estimation", CVIU 1996: a mask that planes and edges along the
    axes do not pass.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    detail = cv2.filter2D(image.astype(np.float32), -1, mask) ** 2
    size = _NOISE_TILE_PX
    rows, columns = image.shape[0] // size, image.shape[1] // size
    if not rows or not columns:
        return np.empty(0)

    def tiles(values: np.ndarray) -> np.ndarray:
        cut = values[: rows * size, : columns * size]
        return cut.reshape(rows, size, columns, size).swapaxes(1, 2).reshape(rows * columns, -1)

    levels = tiles(image)
    sound = (levels.min(1) > _DARK) & (levels.max(1) < _BRIGHT)
    if not sound.any():
        return np.empty(0)
    variance = np.sort(tiles(detail)[sound].mean(1))
    return np.array([np.sqrt(variance[: max(1, round(_EVEN_SHARE * len(variance)))].mean())])


def _sharpness(image: np.ndarray) -> np.ndarray:
    fine = image.astype(np.float32)
    half = cv2.resize(fine, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    of_fine, of_half = (float(np.sqrt(np.mean(cv2.Laplacian(x, cv2.CV_32F) ** 2))) for x in (fine, half))
    return np.array([of_fine / of_half]) if of_half > 0 else np.empty(0)


def _empty_tiles(shape: tuple[int, ...], places: np.ndarray) -> float:
    side = shape[1] / _TILES_ACROSS
    rows = max(1, round(shape[0] / side))
    ends = [[0, shape[0]], [0, shape[1]]]
    counts = np.histogram2d(places[:, 1], places[:, 0], (rows, _TILES_ACROSS), ends)[0]
    return float(np.mean(counts == 0))
