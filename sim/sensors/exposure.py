"""Exposure during motion: the light that the sensor collects, from one sharp frame.

For every pixel the light is summed over the exposure along the path that its point took through the sharp
frame, in linear light. The path follows from the depth and the camera's poses at the shutter's opening,
centre and closing. Depth is taken as constant along a pixel's path. That is wrong at the outlines of near
surfaces, where ``sim.sensors.outlines`` follows the rays instead.
"""

import cv2
import numpy as np
from numba import njit

from dslab.sim.link import View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.outlines import TILE_PX, integrate_outlines, inverse_depths, outline_tiles
from dslab.sim.sensors.tone import DECODE, ENCODE

# A shorter smear than this is invisible.
SHARP_PX = np.float32(0.3)
# Pixels of smear per sample, and the largest number of samples.
PX_PER_SAMPLE = np.float32(1.25)
MAX_SAMPLES = 64
# The median smear is taken over a grid with this spacing.
GRID_PX = 16


class Exposure:
    """The open shutter, as a link of the imaging chain.

    Args:
        camera: intrinsics without distortion.
        frames: number of frames of the plan, N.

    Attributes:
        blur_px: (N,) float64 median length of the motion blur of each frame that was exposed, pixels.
    """

    def __init__(self, camera: Intrinsics, frames: int) -> None:
        self._camera, self.blur_px = camera, np.zeros(frames)

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        assert view.depth_m is not None and view.shutter is not None
        _, opening, closing = view.shutter
        image, self.blur_px[view.index] = expose(image, view.depth_m, self._camera, opening, closing)
        return image, view


def expose(
    gray: np.ndarray, depth_m: np.ndarray, camera: Intrinsics, T_mid_open: np.ndarray, T_mid_close: np.ndarray
) -> tuple[np.ndarray, float]:
    """Expose a frame: sum the light over the open shutter.

    Args:
        gray: (H, W) uint8 sharp frame at the centre of the exposure, sRGB-encoded.
        depth_m: (H, W) float32 depth along the optical axis, 0 for none (taken as very far).
        camera: intrinsics without distortion.
        T_mid_open: (4, 4) camera at the shutter's opening to camera at its centre.
        T_mid_close: (4, 4) the same for its closing.

    Returns:
        (H, W) uint8 sRGB-encoded frame, and the median length of the smear in pixels.
    """
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    opening, closing = (np.ascontiguousarray(T[:3], np.float32) for T in (T_mid_open, T_mid_close))
    lengths = smear_lengths(depth_m, intrinsics, opening, closing)
    median_px = float(np.median(lengths))
    # Between the grid's pixels the smear is hardly longer than on them.
    if lengths.max() < 0.8 * SHARP_PX:
        return gray.copy(), median_px
    linear = cv2.LUT(gray, DECODE)
    inverse_depth = inverse_depths(depth_m)
    near, far = outline_tiles(inverse_depth, intrinsics, opening, closing)
    image = integrate(gray, linear, depth_m, intrinsics, opening, closing, ENCODE, near)
    integrate_outlines(image, linear, inverse_depth, intrinsics, opening, closing, ENCODE, near, far)
    return image, median_px


@njit(cache=True, nogil=True, error_model="numpy")
def row_shifts(row, depth_row, k, T, shift_x, shift_y):
    """Shifts, into the sharp frame, of the points a row sees from another pose.

    Without branches and calls, so that the compiler vectorises it.
    """
    y = (np.float32(row) - k[3]) / k[1]
    from_y_x, from_y_y, from_y_z = T[0, 1] * y + T[0, 2], T[1, 1] * y + T[1, 2], T[2, 1] * y + T[2, 2]
    one_px = np.float32(1) / k[0]
    near, far = np.float32(0.05), np.float32(1e-4)
    for column in range(len(depth_row)):
        u = np.float32(column)
        x = (u - k[2]) * one_px
        inverse_depth = np.float32(1) / depth_row[column] if depth_row[column] > far else far
        to_x = T[0, 0] * x + from_y_x + T[0, 3] * inverse_depth
        to_y = T[1, 0] * x + from_y_y + T[1, 3] * inverse_depth
        to_z = max(T[2, 0] * x + from_y_z + T[2, 3] * inverse_depth, near)
        inverse_z = np.float32(1) / to_z
        shift_x[column] = k[0] * to_x * inverse_z + k[2] - u
        shift_y[column] = k[1] * to_y * inverse_z + k[3] - np.float32(row)


@njit(cache=True, nogil=True, error_model="numpy")
def smear_lengths(depth_m, k, T_open, T_close):
    """(n,) float32 smear length of every ``GRID_PX``-th pixel; arguments as ``integrate``'s."""
    height, width = depth_m.shape
    lengths = np.empty(((height + GRID_PX - 1) // GRID_PX, (width + GRID_PX - 1) // GRID_PX), np.float32)
    shifts = np.empty((4, width), np.float32)
    open_x, open_y, close_x, close_y = shifts[0], shifts[1], shifts[2], shifts[3]
    for i in range(lengths.shape[0]):
        row = i * GRID_PX
        row_shifts(row, depth_m[row], k, T_open, open_x, open_y)
        row_shifts(row, depth_m[row], k, T_close, close_x, close_y)
        for j in range(lengths.shape[1]):
            column = j * GRID_PX
            along_x, along_y = close_x[column] - open_x[column], close_y[column] - open_y[column]
            lengths[i, j] = np.sqrt(along_x * along_x + along_y * along_y)
    return lengths.ravel()


@njit(cache=True, nogil=True, error_model="numpy")
def integrate(gray, linear, depth_m, k, T_open, T_close, encode, near):
    """Sum the light along every pixel's path; (H, W) uint8.

    Arguments as in ``sim.sensors.outlines``; ``gray`` is the sharp frame. Tiles of ``near`` with outlines
    stay sharp.
    """
    height, width = gray.shape
    codes, half = np.float32(len(encode) - 1), np.float32(0.5)
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0)
    shifts = np.empty((4, width), np.float32)
    open_x, open_y, close_x, close_y = shifts[0], shifts[1], shifts[2], shifts[3]
    light_at, one = linear.ravel(), np.uint64(1)
    out = np.empty_like(gray)
    for row in range(height):
        row_shifts(row, depth_m[row], k, T_open, open_x, open_y)
        row_shifts(row, depth_m[row], k, T_close, close_x, close_y)
        for column in range(width):
            # The parabola through opening, centre and closing, over s from -1 to 1.
            along_x = half * (close_x[column] - open_x[column])
            along_y = half * (close_y[column] - open_y[column])
            length = np.float32(2) * np.sqrt(along_x * along_x + along_y * along_y)
            if length < SHARP_PX or near[row // TILE_PX, column // TILE_PX] >= zero:
                out[row, column] = gray[row, column]
                continue
            bend_x = half * (close_x[column] + open_x[column])
            bend_y = half * (close_y[column] + open_y[column])
            count = min(MAX_SAMPLES, max(2, np.int32(length / PX_PER_SAMPLE) + 1))
            step = np.float32(2) / np.float32(count)
            s = half * step - np.float32(1)
            light, seen = zero, zero
            for _ in range(count):
                x = np.float32(column) + s * (along_x + s * bend_x)
                y = np.float32(row) + s * (along_y + s * bend_y)
                s += step
                # Light from outside the frame is unknown: the mean of the rest replaces it.
                if x < zero or y < zero or x >= right or y >= bottom:
                    continue
                left, top = np.int32(x), np.int32(y)
                part_x, part_y = x - np.float32(left), y - np.float32(top)
                # An unsigned index saves a test for negative ones.
                at = np.uint64(top * width + left)
                under = at + np.uint64(width)
                upper = light_at[at] + part_x * (light_at[at + one] - light_at[at])
                lower = light_at[under] + part_x * (light_at[under + one] - light_at[under])
                light += upper + part_y * (lower - upper)
                seen += np.float32(1)
            if seen > zero:
                out[row, column] = encode[np.int32(light / seen * codes + half)]
            else:
                out[row, column] = gray[row, column]
    return out
