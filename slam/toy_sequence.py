"""A small synthetic sequence, which takes no rendering."""

from collections.abc import Iterator

import cv2
import numpy as np

from dslab.slam.core.camera import PinholeCamera

CAMERA = PinholeCamera(320, 240, 260.0, 260.0, 159.5, 119.5, 30.0)
_LAYERS = ((7.0, 0.0, 1.0), (5.0, 0.0, 0.35), (4.0, 0.55, 0.85), (6.0, 0.35, 0.6))  # depth, top, bottom
_PX_PER_M = 90.0


def toy_frames(
    count: int, blank: range = range(0), seed: int = 0, step_m: float = 0.03
) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    """Synthetic sequence of a camera moving past textured boards at several depths.

    Args:
        count: number of frames.
        blank: frames with an empty image.
        seed: seed of the textures and the noise.
        step_m: sideways motion per frame.

    Yields:
        image (240, 320) uint8, stamp_s, T_world_cam (4, 4).
    """
    rng = np.random.default_rng(seed)
    travel = count * step_m
    boards = [_board(rng, travel) for _ in _LAYERS]
    for i in range(count):
        T_world_cam = np.eye(4)
        T_world_cam[:3, 3] = i * step_m, 0.05 * np.sin(i / 9), 0.1 * np.sin(i / 15)
        image = np.full((CAMERA.height_px, CAMERA.width_px), 120, np.uint8)
        if i not in blank:
            for board, (depth, top, bottom) in zip(boards, _LAYERS, strict=True):
                _draw(image, board, depth, top, bottom, T_world_cam[:3, 3])
            noise = rng.normal(0, 1.5, image.shape)
            image = np.clip(image + noise, 0, 255).astype(np.uint8)
        yield image, i / CAMERA.fps, T_world_cam


def _board(rng: np.random.Generator, travel_m: float) -> np.ndarray:
    """Texture of coarse and fine random blocks, wide enough for the whole path."""
    width, height = int((travel_m + 12) * _PX_PER_M), int(9 * _PX_PER_M)
    texture = np.zeros((height, width), np.float32)
    for block, weight in ((6, 0.3), (14, 0.3), (40, 0.4)):
        coarse = rng.integers(0, 256, (height // block + 1, width // block + 1)).astype(np.float32)
        texture += weight * np.kron(coarse, np.ones((block, block), np.float32))[:height, :width]
    return cv2.GaussianBlur(texture, (0, 0), 0.8).astype(np.uint8)


def _draw(
    image: np.ndarray, board: np.ndarray, depth: float, top: float, bottom: float, centre: np.ndarray
) -> None:
    """Draw one fronto-parallel board between the shares ``top`` and ``bottom`` of its height."""
    z = depth - centre[2]
    focal = CAMERA.fx / z
    board_to_image = np.array(
        [
            [focal / _PX_PER_M, 0, CAMERA.cx - focal * (6 + centre[0])],
            [0, focal / _PX_PER_M, CAMERA.cy - focal * (4.5 + centre[1])],
            [0, 0, 1.0],
        ]
    )
    size = (image.shape[1], image.shape[0])
    mask = np.zeros(board.shape, np.uint8)
    rows = slice(int((0.25 + 0.5 * top) * len(board)), int((0.25 + 0.5 * bottom) * len(board)))
    mask[rows if bottom - top < 1 else slice(None)] = 255
    seen = cv2.warpPerspective(mask, board_to_image, size, flags=cv2.INTER_NEAREST) > 0
    image[seen] = cv2.warpPerspective(board, board_to_image, size, flags=cv2.INTER_AREA)[seen]
