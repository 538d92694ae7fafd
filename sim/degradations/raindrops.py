"""Falling rain: size, speed and visible streaks of its drops.

The drops are points in the world that repeat with the sides of a box; the drawn box stays in front of the
camera.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

MOST_MMPH = 300.0
"""Drops are drawn for this rate; a weaker rain has a subset of them."""

_PER_M3_MM = 8000.0
_SLOPE_PER_MM, _SLOPE_POWER = 4.1, -0.21
# A drop that withholds less light from a pixel is invisible.
_FAINT = 1e-3
_LARGEST_MM = 6.0  # larger ones break up
# Smaller drops are too faint and too many to be drawn one by one; they are part of the haze.
_SMALLEST_SEEN_MM = 1.0

BOX_M = 4.0
REACH_M = 3.0
"""Depth up to which drops are drawn one by one."""
_AHEAD_M = 1.6  # from the camera to the middle of the box


def slope_per_mm(rate_mmph: float) -> float:
    """Slope ``L`` of ``N(D) = 8000 exp(-L D)``, drops per m^3 and mm.

    Source: Marshall, Palmer, 1948.
    """
    return _SLOPE_PER_MM * rate_mmph**_SLOPE_POWER


def drops_per_m3(rate_mmph: float, smallest_mm: float) -> float:
    """Number of drops of at least a diameter in a cubic metre."""
    slope = slope_per_mm(rate_mmph)
    return _PER_M3_MM / slope * float(np.exp(-slope * smallest_mm))


def extinction_per_m(rate_mmph: float) -> float:
    """Light lost in rain per metre: twice the area of all its drops.

    Source: van de Hulst, "Light scattering by small particles", 1957: extinction by bodies much larger
    than the wavelength.
    """
    # The integral of 2 (pi / 4) D^2 N(D), from mm^2 to m^2.
    return np.pi * _PER_M3_MM / slope_per_mm(rate_mmph) ** 3 * 1e-6 if rate_mmph > 0 else 0.0


def fall_mps(diameter_mm: np.ndarray) -> np.ndarray:
    """Fall speed of drops of 0.6 to 6 mm. Source: Atlas, Srivastava, Sekhon, 1973."""
    return np.maximum(9.65 - 10.3 * np.exp(-0.6 * diameter_mm), 0.1)


def draw_drops(count: int, smallest_mm: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Drops of the heaviest rain: (count,) diameters, mm, and (count,) least rain rates.

    A rain has the drops whose least rate does not exceed its own; their sizes then follow its distribution.
    """
    slope = slope_per_mm(MOST_MMPH)
    diameter_mm = np.minimum(smallest_mm + rng.exponential(1 / slope, count), _LARGEST_MM)
    # A drop of a weaker rain with chance exp(-(its slope - the steepest) D).
    power = MOST_MMPH**_SLOPE_POWER + rng.exponential(1.0, count) / (_SLOPE_PER_MM * diameter_mm)
    return diameter_mm, power ** (1 / _SLOPE_POWER)


@dataclass(frozen=True)
class RainField:
    """Falling drops.

    Attributes:
        place_m: (n, 3) float32, world frame, within the box.
        velocity_mps: (n, 3) float32, world frame.
        diameter_m: (n,) float32.
        from_mmph: (n,) float32 least rain rate that has the drop.
    """

    place_m: np.ndarray
    velocity_mps: np.ndarray
    diameter_m: np.ndarray
    from_mmph: np.ndarray

    @classmethod
    def drawn(cls, rate_mmph: float, wind_mps: np.ndarray, rng: np.random.Generator) -> "RainField":
        """The drops of a rain.

        Args:
            rate_mmph: highest rain rate.
            wind_mps: (2,) horizontal wind that carries the drops.
            rng: the same stream gives a stronger rain the drops of a weaker one and more.
        """
        count = round(drops_per_m3(MOST_MMPH, _SMALLEST_SEEN_MM) * BOX_M**3)
        diameter_mm, from_mmph = draw_drops(count, _SMALLEST_SEEN_MM, rng)
        place_m = rng.uniform(0, BOX_M, (count, 3)).astype(np.float32)
        there = from_mmph <= rate_mmph
        fall = -fall_mps(diameter_mm[there])
        velocity = np.column_stack([np.broadcast_to(wind_mps, (len(fall), 2)), fall])
        return cls(
            place_m[there],
            velocity.astype(np.float32),
            (diameter_mm[there] / 1000).astype(np.float32),
            from_mmph[there].astype(np.float32),
        )

    def passing(
        self,
        depth_m: np.ndarray,
        k: np.ndarray,
        T_world_open: np.ndarray,
        T_world_close: np.ndarray,
        stamp_s: float,
        exposure_s: float,
        rate_mmph: float,
    ) -> np.ndarray:
        """(H, W) float32 share of the light that passes between the drops during an exposure.

        Args:
            depth_m: (H, W) float32, 0 for none.
            k: (4,) float32 fx, fy, cx, cy.
            T_world_open, T_world_close: (4, 4) camera to world when the shutter opens and closes.
            stamp_s, exposure_s: centre of the exposure, and its length.
            rate_mmph: rain at that time.
        """
        centre = (T_world_open[:3, 3] + T_world_close[:3, 3]) / 2 + _AHEAD_M * T_world_close[:3, 2]
        passing = np.ones_like(depth_m)
        draw_streaks(
            self.place_m,
            self.velocity_mps,
            self.diameter_m,
            self.from_mmph,
            np.linalg.inv(T_world_open)[:3],
            np.linalg.inv(T_world_close)[:3],
            centre,
            np.array([stamp_s, exposure_s, rate_mmph]),
            depth_m,
            k.astype(float),
            passing,
        )
        return passing


@njit(cache=True, nogil=True, error_model="numpy")
def draw_streaks(
    place_m, velocity_mps, diameter_m, from_mmph, T_open, T_close, centre, when, depth_m, k, passing
):
    """Multiply ``passing`` by the share of light that each drop leaves.

    A drop covers a pixel for the share of the exposure in which its disc passes over it.

    Args:
        place_m, velocity_mps, diameter_m, from_mmph: of a ``RainField``.
        T_open, T_close: (3, 4) float64 world to camera at both ends of the exposure.
        centre: (3,) float64 middle of the box.
        when: (3,) float64 centre of the exposure, its length, rain rate.
        depth_m: (H, W) float32.
        k: (4,) float64 fx, fy, cx, cy.
        passing: (H, W) float32, changed.
    """
    stamp_s, half_s, rate = when[0], when[1] / 2, when[2]
    height, width = depth_m.shape
    point = np.empty(3)
    ends = np.empty((2, 3))
    for drop in range(len(diameter_m)):
        if from_mmph[drop] > rate:
            continue
        for axis in range(3):
            off = place_m[drop, axis] + velocity_mps[drop, axis] * stamp_s - centre[axis] + BOX_M / 2
            point[axis] = off - np.floor(off / BOX_M) * BOX_M - BOX_M / 2 + centre[axis]
        for axis in range(3):
            opened, closed = T_open[axis, 3], T_close[axis, 3]
            for j in range(3):
                way = velocity_mps[drop, j] * half_s
                opened += T_open[axis, j] * (point[j] - way)
                closed += T_close[axis, j] * (point[j] + way)
            ends[0, axis], ends[1, axis] = opened, closed
        z = (ends[0, 2] + ends[1, 2]) / 2
        if min(ends[0, 2], ends[1, 2]) < 0.2 or z > REACH_M:
            continue
        x0, y0 = k[0] * ends[0, 0] / ends[0, 2] + k[2], k[1] * ends[0, 1] / ends[0, 2] + k[3]
        x1, y1 = k[0] * ends[1, 0] / ends[1, 2] + k[2], k[1] * ends[1, 1] / ends[1, 2] + k[3]
        column, row = int(np.rint((x0 + x1) / 2)), int(np.rint((y0 + y1) / 2))
        if 0 <= column < width and 0 <= row < height and 0 < depth_m[row, column] < z:
            continue
        size = k[0] * diameter_m[drop] / z
        _streak(x0, y0, x1, y1, size, passing)


@njit(cache=True, nogil=True, error_model="numpy")
def _streak(x0, y0, x1, y1, size, passing):
    """Draw a disc that moves along a line; its size is in pixels."""
    height, width = passing.shape
    along_x, along_y = x1 - x0, y1 - y0
    length = np.sqrt(along_x * along_x + along_y * along_y)
    broad = max(size, 1.0)
    share = min(1.0, np.pi / 4 * size * size / (broad * (length + broad)))
    if share < _FAINT:
        return
    unit_x, unit_y = (along_x / length, along_y / length) if length > 1e-6 else (0.0, 1.0)
    reach = broad / 2 + 0.5
    upright = abs(unit_y) >= abs(unit_x)
    # Line by line across the larger of its two extents.
    slant = unit_x / unit_y if upright else unit_y / unit_x
    spread = reach / max(abs(unit_x), abs(unit_y))
    first, last = (min(y0, y1), max(y0, y1)) if upright else (min(x0, x1), max(x0, x1))
    lines, across = (height, width) if upright else (width, height)
    middle_x, middle_y = (x0 + x1) / 2, (y0 + y1) / 2
    for line in range(max(0, int(first - reach)), min(lines - 1, int(last + reach) + 1) + 1):
        on = middle_x + (line - middle_y) * slant if upright else middle_y + (line - middle_x) * slant
        for other in range(max(0, int(on - spread)), min(across - 1, int(on + spread) + 1) + 1):
            x, y = (other, line) if upright else (line, other)
            from_x, from_y = x - middle_x, y - middle_y
            beside = reach - abs(from_x * unit_y - from_y * unit_x)
            beyond = length / 2 + reach - abs(from_x * unit_x + from_y * unit_y)
            cover = max(0.0, min(1.0, beside)) * max(0.0, min(1.0, beyond))
            passing[y, x] *= np.float32(1.0 - share * cover)
