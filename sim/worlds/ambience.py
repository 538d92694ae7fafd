"""Options that act on a whole world: light of the lamps, haze."""

from dataclasses import replace

import cv2
import numpy as np

from dslab.scenarios.worlds import Outdoors
from dslab.sim.worlds.base import Haze, WorldModel

# Visibility is where a contrast of 1 is down to 0.02: ln 50. Source: Koschmieder's law.
_VISIBILITY_EXPONENT = 3.912
_AIRLIGHT_LEVEL = 186.0  # the level of the sky at the horizon


def dimmed(world: WorldModel, level: float) -> WorldModel:
    """Scale the light of a world, lamps included; the exposure stays.

    Args:
        world: left unchanged.
        level: light relative to before; 1 returns the world itself.
    """
    if level == 1.0:
        return world
    table = np.clip(np.rint(level * np.arange(256)), 0, 255).astype(np.uint8)
    surfaces = [replace(surface, texture=cv2.LUT(surface.texture, table)) for surface in world.surfaces]
    return replace(world, surfaces=surfaces, mean_level=level * world.mean_level)


def hazed(world: WorldModel, weather: Outdoors) -> WorldModel:
    """The world with the weather's haze."""
    if weather.haze_m is None:
        return world
    return replace(world, haze=Haze(_VISIBILITY_EXPONENT / weather.haze_m, _AIRLIGHT_LEVEL))
