"""Rain on the glass before the lens: drops land, merge and run down."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from dslab.sim.degradations.raindrops import MOST_MMPH, draw_drops, drops_per_m3
from dslab.sim.sensors.camera import Intrinsics

_SMALLEST_MM = 0.5
_RADIUS_PER_DIAMETER = 0.25 ** (1 / 3)  # radius of a half ball relative to the ball of the same volume
_RUNNING_MM = 2.7  # the capillary length of water: a larger drop runs down
_RUNNING_MMPS = 25.0
_SPREADING_S = 0.15
_MOST_LANDINGS = 20_000
_APERTURE_MM = 0.8  # of the lens, which sets the defocus of the glass
_COARSE = 20  # the view through a drop is out of focus too
_BULGE = 0.7  # a drop shows this share of the image's height to either side of its middle


@dataclass(frozen=True)
class WetGlass:
    """All drops that land on the glass before a camera, up to some time.

    Attributes:
        land_s: (n,) float64 time of landing.
        place_mm: (n, 2) float64 on the glass, right and down from the optical axis.
        volume_mm3: (n,) float64.
        from_mmph: (n,) float64 least rain rate that has the drop.
        parent: (n,) int64 the drop into which it merges, its own number if none.
        run_s: (n,) float64 time at which a drop becomes too heavy and runs down, infinite if never.
        glass_mm: distance of the glass from the lens.
    """

    land_s: np.ndarray
    place_mm: np.ndarray
    volume_mm3: np.ndarray
    from_mmph: np.ndarray
    parent: np.ndarray
    run_s: np.ndarray
    glass_mm: float

    @classmethod
    def from_rain(
        cls,
        camera: Intrinsics,
        glass_mm: float,
        rate_mmph: float,
        wind_mps: float,
        times_s: tuple[float, float],
        rng: np.random.Generator,
    ) -> "WetGlass":
        """Draw the drops that the wind blows against the glass during a time span."""
        seen_mm = glass_mm * np.array([camera.width_px / camera.fx, camera.height_px / camera.fy])
        half_mm = seen_mm / 2 + _RUNNING_MM
        per_s = drops_per_m3(MOST_MMPH, _SMALLEST_MM) * wind_mps * float(np.prod(2 * half_mm)) * 1e-6
        # In a long rain the last drops are enough: earlier ones have run down.
        duration_s = min(times_s[1] - times_s[0], _MOST_LANDINGS / per_s) if per_s > 0 else 0.0
        count = round(per_s * duration_s)
        diameter_mm, from_mmph = draw_drops(count, _SMALLEST_MM, rng)
        land_s = times_s[1] - duration_s * np.sort(rng.uniform(0, 1, count))[::-1]
        place_mm = rng.uniform(-half_mm, half_mm, (count, 2))
        there = from_mmph <= rate_mmph
        land_s, place_mm, volume = land_s[there], place_mm[there], (np.pi / 6 * diameter_mm**3)[there]
        parent, run_s = merge(land_s, place_mm, volume)
        return cls(land_s, place_mm, volume, from_mmph[there], parent, run_s, glass_mm)

    def drops_px(self, camera: Intrinsics, stamp_s: float, rate_mmph: float) -> np.ndarray:
        """(m, 3) float32 x, y and radius, pixels, of the drops on the glass."""
        spread = np.clip((stamp_s - self.land_s) / _SPREADING_S, 0, 1) * (self.from_mmph <= rate_mmph)
        volume = np.bincount(self.parent, self.volume_mm3 * spread, len(self.land_s))
        run_mm = _RUNNING_MMPS * np.maximum(stamp_s - self.run_s, 0)
        radius_mm = radius_of(volume)
        px_per_mm = np.array([camera.fx, camera.fy]) / self.glass_mm
        place = self.place_mm * px_per_mm + (camera.cx, camera.cy)
        place[:, 1] += run_mm * px_per_mm[1]
        drops = np.column_stack([place, radius_mm * px_per_mm[0]])[volume > 0]
        return drops[drops[:, 1] - 2 * drops[:, 2] < camera.height_px].astype(np.float32)

    def rendered(
        self, light: np.ndarray, drops: np.ndarray, camera: Intrinsics
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render the drops as a camera sees them.

        Args:
            light: (H, W) float32 light without the drops.
            drops: of ``drops_px``.
            camera: intrinsics.

        Returns:
            (H, W) float32 cover, 0 clear to 1 drop, and (H, W) float32 light through the drops.
        """
        small = (max(4, light.shape[1] // _COARSE), max(4, light.shape[0] // _COARSE))
        coarse = cv2.resize(light, small, interpolation=cv2.INTER_AREA)
        cover, through = np.zeros_like(light), np.zeros_like(light)
        soft_px = max(1.0, camera.fx * _APERTURE_MM / self.glass_mm)
        paint_drops(drops, np.float32(soft_px), coarse, cover, through)
        return cover, through


def radius_of(volume_mm3: np.ndarray) -> np.ndarray:
    """Radius of the half ball of a volume, mm."""
    return _RADIUS_PER_DIAMETER * np.cbrt(6 / np.pi * volume_mm3)


@njit(cache=True, nogil=True)
def merge(land_s, place_mm, volume_mm3):
    """Merge drops that touch, and find the times at which they run down.

    Args:
        land_s: (n,) float64, ascending.
        place_mm: (n, 2) float64.
        volume_mm3: (n,) float64.

    Returns:
        (n,) int64 parents and (n,) float64 times of running down.
    """
    count = len(land_s)
    parent, run_s = np.arange(count), np.full(count, np.inf)
    whole = np.zeros(count)
    held = np.empty(count, np.int64)
    holding = 0
    for drop in range(count):
        into = drop
        for at in range(holding):
            other = held[at]
            x, y = place_mm[drop] - place_mm[other]
            reach = _RADIUS_PER_DIAMETER * np.cbrt(6 / np.pi * whole[other])
            if x * x + y * y < reach * reach:
                into = other
                break
        parent[drop] = into
        whole[into] += volume_mm3[drop]
        if into == drop:
            held[holding] = drop
            holding += 1
        if _RADIUS_PER_DIAMETER * np.cbrt(6 / np.pi * whole[into]) > _RUNNING_MM:
            run_s[into] = land_s[drop]
            for at in range(holding):
                if held[at] == into:
                    held[at] = held[holding - 1]
                    holding -= 1
                    break
    return parent, run_s


@njit(cache=True, nogil=True, error_model="numpy")
def paint_drops(drops, soft_px, coarse, cover, through):
    """Write the drops' cover of each pixel and the light through them: the inverted scene.

    Of several drops over a pixel, the one with the largest cover shows.

    Args:
        drops: (m, 3) float32 x, y, radius, pixels.
        soft_px: float32 width of a drop's rim, which is out of focus.
        coarse: (h, w) float32 the scene, small.
        cover: (H, W) float32 of zeros, written.
        through: (H, W) float32, written.
    """
    height, width = cover.shape
    small_height, small_width = coarse.shape
    half = soft_px / np.float32(2)
    one, zero = np.float32(1), np.float32(0)
    reach_px = np.float32(_BULGE * height)
    for at in range(len(drops)):
        x, y, radius = drops[at]
        outer = radius + half
        # A drop smaller than its own blur never covers a pixel wholly.
        most = min(one, (radius / half) ** 2)
        for row in range(max(0, int(np.ceil(y - outer))), min(height - 1, int(y + outer)) + 1):
            for column in range(max(0, int(np.ceil(x - outer))), min(width - 1, int(x + outer)) + 1):
                away_x, away_y = np.float32(column) - x, np.float32(row) - y
                away = np.sqrt(away_x * away_x + away_y * away_y)
                covered = most * max(zero, min(one, (outer - away) / soft_px))
                if covered <= cover[row, column]:
                    continue
                cover[row, column] = covered
                seen_x = (x - away_x / outer * reach_px + np.float32(0.5)) * small_width / width
                seen_y = (y - away_y / outer * reach_px + np.float32(0.5)) * small_height / height
                light = _between(coarse, seen_x - np.float32(0.5), seen_y - np.float32(0.5))
                # Towards its rim a drop turns light away from the lens.
                edge = (away / outer) ** 2
                through[row, column] = light * (np.float32(1.05) - np.float32(0.6) * edge * edge)


@njit(cache=True, nogil=True, error_model="numpy")
def _between(image, x, y):
    """Value between pixels; the image is reflected beyond its border."""
    height, width = image.shape
    x, y = _folded(x, np.float32(width - 1.001)), _folded(y, np.float32(height - 1.001))
    column, row = int(x), int(y)
    right, down = np.float32(x - column), np.float32(y - row)
    one = np.float32(1)
    upper = (one - right) * image[row, column] + right * image[row, column + 1]
    lower = (one - right) * image[row + 1, column] + right * image[row + 1, column + 1]
    return (one - down) * upper + down * lower


@njit(cache=True, nogil=True, error_model="numpy")
def _folded(at, last):
    """An index reflected at 0 and at the last index, once each."""
    at = abs(at)
    return max(np.float32(0), last - abs(last - at))
