"""Moving objects: textured things that pass in front of everything, each with a motion of its own."""

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from scenarios.segments import MovingObjects
from sim.camera import Intrinsics
from sim.degradations.base import Stage
from sim.degradations.image import Filter, ImageDegradation, Streams, View

FELT_SHARE = 0.1
_SIZES = (0.18, 0.5)  # of the image's height
_SPEEDS = (0.6, 1.4)  # of the stated rate
_MAX_SPRITES = 400


@dataclass(frozen=True)
class Sprite:
    """One moving thing.

    Attributes:
        texture: (h, w) uint8.
        mask: (h, w) uint8, 255 on the thing and 0 beside it.
        place_px: (2,) x, y of its upper left corner at the segment's start.
        velocity_pxps: (2,) of the same.
    """

    texture: np.ndarray
    mask: np.ndarray
    place_px: np.ndarray
    velocity_pxps: np.ndarray


class MovingObjectsDegradation(ImageDegradation[MovingObjects]):
    """Draws things that leave the view on one side and come in on the other, so that their share lasts."""

    kind: ClassVar[str] = "moving_objects"
    stage: ClassVar[Stage] = Stage.SCENE
    measure_name: ClassVar[str] = "foreign_share"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Share of the view and speed."""
        return {"share": float(rng.uniform(0.1, 0.9)), "rate_degps": float(rng.uniform(5, 60))}

    def prepare(self, segment: MovingObjects, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``."""
        sprites, shares = _crowd(segment, camera, streams("sprites"))

        def pass_by(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            # The first things whose share reaches the one asked for: on a ramp they come one by one.
            count = int(np.searchsorted(shares, view.strength * segment.share - 1e-9))
            if count == 0:
                return image, 0.0
            out, foreign = image.copy(), np.zeros_like(image)
            for sprite in sprites[:count]:
                _draw(sprite, view.stamp_s - segment.start_s, out, foreign)
            return out, float((foreign > 0).mean())

        return pass_by

    def threshold(self, segment: MovingObjects) -> float:
        """A tenth of the view, or half of the share asked for, if that is less."""
        return min(FELT_SHARE, segment.share / 2)


def _crowd(
    segment: MovingObjects, camera: Intrinsics, rng: np.random.Generator
) -> tuple[list[Sprite], np.ndarray]:
    """Things in a fixed order and (n + 1,) the share that the first 0, 1, 2 ... of them fill together."""
    sprites: list[Sprite] = []
    shares = [0.0]
    foreign = np.zeros((camera.height_px, camera.width_px), np.uint8)
    pxps = np.deg2rad(segment.rate_degps) * camera.fx
    while shares[-1] < segment.share and len(sprites) < _MAX_SPRITES:
        sprites.append(_sprite(camera, pxps, rng))
        _draw(sprites[-1], 0.0, np.empty_like(foreign), foreign)
        shares.append(float((foreign > 0).mean()))
    return sprites, np.array(shares)


def _sprite(camera: Intrinsics, pxps: float, rng: np.random.Generator) -> Sprite:
    height = max(8, round(camera.height_px * float(rng.uniform(*_SIZES))))
    width = min(camera.width_px, max(8, round(height * float(rng.uniform(0.6, 1.8)))))
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    # Between an ellipse and a rounded box.
    mask = (np.abs(x) ** 4 + np.abs(y) ** 4 <= 1).astype(np.uint8) * 255
    direction = np.deg2rad(rng.uniform(-20, 20)) + np.pi * rng.integers(2)
    speed = pxps * float(rng.uniform(*_SPEEDS))
    return Sprite(
        texture=_texture(height, width, rng),
        mask=mask,
        place_px=rng.uniform(0, [camera.width_px, camera.height_px]),
        velocity_pxps=speed * np.array([np.cos(direction), np.sin(direction)]),
    )


def _texture(height: int, width: int, rng: np.random.Generator) -> np.ndarray:
    """Patches of three sizes about a level of the thing's own, lit from above."""
    level = np.full((height, width), rng.uniform(60, 180), np.float32)
    for patch_px, spread, between in (
        (24, 25, cv2.INTER_NEAREST),
        (9, 18, cv2.INTER_NEAREST),
        (3, 10, cv2.INTER_LINEAR),
    ):
        grid = (max(2, height // patch_px), max(2, width // patch_px))
        values = rng.normal(0, spread, grid).astype(np.float32)
        level += cv2.resize(values, (width, height), interpolation=between)
    level *= np.linspace(1.2, 0.7, height, dtype=np.float32)[:, None]
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def _draw(sprite: Sprite, since_s: float, out: np.ndarray, foreign: np.ndarray) -> None:
    """Draws the thing into both, parts beyond a border at the opposite one."""
    rows, columns = out.shape
    place = sprite.place_px + since_s * sprite.velocity_pxps
    whole = np.floor(place).astype(int)
    shift = np.array([[1, 0, place[0] - whole[0]], [0, 1, place[1] - whole[1]]], np.float32)
    size = (sprite.mask.shape[1] + 1, sprite.mask.shape[0] + 1)
    texture = cv2.warpAffine(sprite.texture, shift, size, borderMode=cv2.BORDER_REPLICATE)
    mask = cv2.warpAffine(sprite.mask, shift, size) > 127
    left, top = int(whole[0] % columns), int(whole[1] % rows)
    for x in (left, left - columns):
        for y in (top, top - rows):
            _paste(texture, mask, x, y, out, foreign)


def _paste(
    texture: np.ndarray, mask: np.ndarray, x: int, y: int, out: np.ndarray, foreign: np.ndarray
) -> None:
    from_y, from_x = max(0, -y), max(0, -x)
    to_y, to_x = min(mask.shape[0], out.shape[0] - y), min(mask.shape[1], out.shape[1] - x)
    if from_y >= to_y or from_x >= to_x:
        return
    part = (slice(from_y, to_y), slice(from_x, to_x))
    there = (slice(from_y + y, to_y + y), slice(from_x + x, to_x + x))
    cv2.copyTo(texture[part], mask[part].astype(np.uint8), out[there])
    foreign[there] |= mask[part]
