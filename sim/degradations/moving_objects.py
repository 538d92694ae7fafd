"""Moving objects: people and vehicles that pass in front of the scene."""

from dataclasses import dataclass

import numpy as np

from dslab.scenarios.segments import MovingObjects
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.passers_by import CAR_M, PERSON_M, POSES, VAN_M, person, vehicle
from dslab.sim.degradations.sprites import Sprite, acting_share, draw_behind, fill_share
from dslab.sim.sensors.camera import Intrinsics

_SPEEDS = (0.6, 1.4)  # of the stated rate
_MOST = 400
_PEOPLE, _CARS = 0.7, 0.9  # cumulative shares of people and of cars
# Image heights of a person: the first are far away, later ones nearer.
_FARTHEST, _NEARER, _NEAREST = 0.4, 1.08, 2.0
_VEHICLE = 0.28  # scale of a vehicle relative to a person's, since vehicles pass farther away
_CAMERA_M = 1.2  # of the camera above the common ground
_STEPS_PER_M = 0.55  # both feet together


@dataclass(frozen=True)
class Passer:
    """One moving object.

    Attributes:
        sprite: its images.
        scale: pixels of the frame per pixel of the sprite.
        px_per_m: of the frame; grows as the object is nearer.
        place_px: (2,) x, y of its upper left corner at the segment's start.
        velocity_pxps: (2,) velocity of that corner.
        poses_ps: sprite poses per second.
    """

    sprite: Sprite
    scale: float
    px_per_m: float
    place_px: np.ndarray
    velocity_pxps: np.ndarray
    poses_ps: float

    def draw(self, since_s: float, light: np.ndarray, open_share: np.ndarray) -> None:
        """Draw it behind everything drawn so far; see ``draw_behind``."""
        pose = int(since_s * self.poses_ps) % len(self.sprite.gray)
        x, y = self.place_px + since_s * self.velocity_pxps
        gray, alpha = self.sprite.gray[pose], self.sprite.alpha[pose]
        draw_behind(gray, alpha, float(x), float(y), self.scale, light, open_share)


class MovingObjectsDegradation(ImageDegradation[MovingObjects]):
    """Draws objects that leave the view on one side and return on the other."""

    kind = "moving_objects"
    stage = Stage.SCENE
    measure_name = "foreign_share"

    def prepare(self, segment: MovingObjects, camera: Intrinsics, streams: Streams) -> Filter:
        passers, shares = _crowd(segment, camera, streams("sprites"))

        def pass_by(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            # The first objects that reach the share; along a ramp they appear one by one.
            count = int(np.searchsorted(shares, view.strength * segment.share - 1e-9))
            if count == 0:
                return image, 0.0
            light = np.zeros(image.shape, np.float32)
            open_share = np.ones(image.shape, np.float32)
            for passer in sorted(passers[:count], key=lambda passer: -passer.px_per_m):
                passer.draw(view.stamp_s - segment.start_s, light, open_share)
            out = np.rint(light + open_share * image).astype(np.uint8)
            return out, 1 - float(open_share.mean())

        return pass_by

    def threshold(self, segment: MovingObjects) -> float:
        """A tenth of the view, or half of a smaller share."""
        return acting_share(segment.share)


def _crowd(
    segment: MovingObjects, camera: Intrinsics, rng: np.random.Generator
) -> tuple[list[Passer], np.ndarray]:
    """Objects from far to near, and (n + 1,) cumulative shares of the view."""
    passers: list[Passer] = []
    size = (camera.height_px, camera.width_px)
    light, open_share = np.zeros(size, np.float32), np.ones(size, np.float32)
    pxps = float(np.deg2rad(segment.rate_degps)) * camera.fx

    def draw_next() -> float:
        passers.append(_passer(camera, pxps, len(passers), rng))
        passers[-1].draw(0.0, light, open_share)
        return 1 - float(open_share.mean())

    return passers, fill_share(segment.share, draw_next, _MOST)


def _passer(camera: Intrinsics, pxps: float, number: int, rng: np.random.Generator) -> Passer:
    """The next object of a crowd, with its feet on the ground below the horizon."""
    near = min(_FARTHEST * _NEARER**number, _NEAREST) * float(rng.uniform(0.85, 1.15))
    px_per_m, what = near * camera.height_px / PERSON_M, rng.uniform()
    walks = what < _PEOPLE
    if walks:
        sprite, tall_m = person(px_per_m, rng), PERSON_M
    else:
        px_per_m, is_van = _VEHICLE * px_per_m, what > _CARS
        sprite, tall_m = vehicle(px_per_m, is_van, rng), VAN_M if is_van else CAR_M
    if rng.uniform() < 0.5:
        sprite, sign = Sprite(sprite.gray[..., ::-1].copy(), sprite.alpha[..., ::-1].copy()), -1
    else:
        sign = 1
    speed = pxps * float(rng.uniform(*_SPEEDS))
    top = camera.cy - (tall_m - _CAMERA_M) * px_per_m
    return Passer(
        sprite=sprite,
        scale=tall_m * px_per_m / sprite.gray.shape[1],
        px_per_m=px_per_m,
        place_px=np.array([float(rng.uniform(0, camera.width_px)), top]),
        velocity_pxps=np.array([sign * speed, 0.0]),
        poses_ps=POSES * _STEPS_PER_M * speed / px_per_m if walks else 0.0,
    )
