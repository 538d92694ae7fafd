"""What every system asks of a frame that is given to it."""

from numbers import Real

import numpy as np

from dslab.slam.core.camera import PinholeCamera


def check_frame(
    image: np.ndarray, stamp_s: float, camera: PinholeCamera, frame: int, last_stamp_s: float
) -> None:
    """Check a frame before it is processed.

    Args:
        image: to be (H, W) uint8, of the camera's size.
        stamp_s: its time, to be later than the last one's.
        camera: of the images.
        frame: its index, for the message.
        last_stamp_s: time of the frame before.

    Raises:
        ValueError: wrong size or type of image, time not increasing.
    """
    shape = (camera.height_px, camera.width_px)
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape != shape:
        got = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f"frame {frame}: expected a uint8 image of shape {shape}, got {got}")
    is_time = isinstance(stamp_s, Real) and np.isfinite(stamp_s)
    if not is_time or not stamp_s > last_stamp_s:
        raise ValueError(f"frame {frame}: time {stamp_s} s is not after the last one, {last_stamp_s} s")
