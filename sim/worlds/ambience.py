"""What the options of a world do to all of it: the light of its lamps, the haze of its air."""

from dataclasses import replace

import cv2
import numpy as np

from scenarios.worlds import Outdoors
from sim.worlds.base import Haze, WorldModel

# Visibility is where a contrast of 1 is down to 0.02: ln 50. Source: Koschmieder's law.
_VISIBILITY_EXPONENT = 3.912
_AIRLIGHT_LEVEL = 186.0  # as the sky at the horizon


def dimmed(world: WorldModel, level: float) -> WorldModel:
    """The world in more or less light, lamps included; the exposure stays.

    Args:
        world: left as it is.
        level: light relative to what it was; 1 gives back the world itself.
    """
    if level == 1.0:
        return world
    table = np.clip(np.rint(level * np.arange(256)), 0, 255).astype(np.uint8)
    surfaces = [replace(surface, texture=cv2.LUT(surface.texture, table)) for surface in world.surfaces]
    return replace(world, surfaces=surfaces, mean_level=level * world.mean_level)


def hazed(world: WorldModel, weather: Outdoors) -> WorldModel:
    """The world in the weather's air."""
    if weather.haze_m is None:
        return world
    return replace(world, haze=Haze(_VISIBILITY_EXPONENT / weather.haze_m, _AIRLIGHT_LEVEL))
