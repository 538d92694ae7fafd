"""What occurs again in an aliased world: textures of twins, and pictures that many surfaces show."""

from collections.abc import Callable

import cv2
import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import Aliasing

_PICTURES = 2  # different pictures of a finish
_MAGNIFIED = 1.8  # largest factor of size, up or down
_SMALLEST_M = 1.0  # side of a picture, of which smaller surfaces show a part
_OTHER_KIND = 0.5  # share of scaled pictures that were drawn for a surface of another kind

Draw = Callable[[str, tuple[float, float], float, np.random.Generator], np.ndarray]
"""Draws a finish, by name, of a size in metres, at pixels per metre: (h, w) uint8."""


class Recurrence:
    """Textures of a world that repeats itself; the same seed gives the same bytes.

    Args:
        aliasing: how much of it.
        seed: root seed; the streams are ``("world", "aliased", ...)``.
        draw: draws new textures.
        kinds: finishes whose pictures surfaces of one another may show; empty for none.
    """

    def __init__(self, aliasing: Aliasing, seed: int, draw: Draw, kinds: tuple[str, ...] = ()) -> None:
        self._aliasing, self._seed, self._draw, self._kinds = aliasing, seed, draw, kinds
        self._drawn: dict[tuple[str, str], np.ndarray] = {}
        self._pictures: dict[tuple[str, int], tuple[np.ndarray, float]] = {}

    def source(self, label: str, twin: str) -> str:
        """Label whose texture a surface shows: its twin's, or its own if the places differ in it."""
        return twin if twin and is_alike(self._aliasing, self._seed, label) else label

    def texture(
        self, label: str, twin: str, finish: str, size_m: tuple[float, float], scale: float
    ) -> np.ndarray:
        """A new array (h, w) uint8 with the unlit texture of a surface.

        ``twin`` is the label of the surface that it repeats if it is no detail that differs, else empty.
        """
        source = self.source(label, twin)
        size = pixels(size_m, scale)
        if (source, finish) not in self._drawn:
            self._drawn[source, finish] = self._new(source, finish, size_m, scale)
        drawn = self._drawn[source, finish]
        if drawn.shape == size[::-1]:
            return drawn.copy()
        return cv2.resize(drawn, size, interpolation=_interpolation(drawn, size))

    def _new(self, source: str, finish: str, size_m: tuple[float, float], scale: float) -> np.ndarray:
        rng = rng_for(self._seed, "world", "aliased", "thing", source)
        if rng.random() >= self._aliasing.things:
            return self._draw(finish, size_m, scale, rng)
        number, magnified, own_finish = int(rng.integers(_PICTURES)), 1.0, finish
        if rng.random() < self._aliasing.scaled:
            magnified = float(_MAGNIFIED ** rng.uniform(-1, 1))
            if finish in self._kinds and rng.random() < _OTHER_KIND:
                finish = str(rng.choice(self._kinds))
        if (finish, number) not in self._pictures:
            stream = rng_for(self._seed, "world", "aliased", "picture", finish, number)
            of_m = (
                (max(size_m[0], _SMALLEST_M), max(size_m[1], _SMALLEST_M))
                if finish in self._kinds
                else size_m
            )
            self._pictures[finish, number] = self._draw(finish, of_m, scale, stream), scale
        picture, picture_scale = self._pictures[finish, number]
        if finish not in self._kinds:
            size = pixels(size_m, scale)
            return cv2.resize(picture, size, interpolation=_interpolation(picture, size))
        needed = _needed(picture, picture_scale, size_m)
        if needed > _MAGNIFIED:
            return self._draw(own_finish, size_m, scale, rng)
        return shown(picture, picture_scale, size_m, scale, max(magnified, needed))


def is_alike(aliasing: Aliasing, seed: int, label: str) -> bool:
    """Return False if the twin with this label is one of the details in which twin places differ."""
    return bool(rng_for(seed, "world", "aliased", "place", label).random() < aliasing.places)


def is_there(aliasing: Aliasing, seed: int, label: str) -> bool:
    """Return False if a thing that stands in one of two twin places is missing in the other."""
    return bool(rng_for(seed, "world", "aliased", "there", label).random() < (1 + aliasing.places) / 2)


def pixels(size_m: tuple[float, float], scale: float) -> tuple[int, int]:
    """Width and height in pixels of a texture at a scale, pixels per metre; at least 8."""
    wide, high = (max(8, round(side * scale)) for side in size_m)
    return wide, high


def shown(
    picture: np.ndarray, picture_scale: float, size_m: tuple[float, float], scale: float, magnified: float
) -> np.ndarray:
    """The upper left of a picture on a surface, undistorted.

    Args:
        picture: (h, w) uint8.
        picture_scale: its pixels per metre.
        size_m, scale: size of the surface, and pixels per metre of its texture.
        magnified: size at which it is shown, relative to that at which it was drawn; enough to fill it.
    """
    rows, columns = (
        min(have, max(8, round(side * picture_scale / magnified)))
        for side, have in zip(size_m[::-1], picture.shape, strict=True)
    )
    part, size = picture[:rows, :columns], pixels(size_m, scale)
    return cv2.resize(part, size, interpolation=_interpolation(part, size))


def _interpolation(image: np.ndarray, size: tuple[int, int]) -> int:
    return cv2.INTER_AREA if image.shape[0] > size[1] else cv2.INTER_LINEAR


def _needed(picture: np.ndarray, picture_scale: float, size_m: tuple[float, float]) -> float:
    """Factor of size by which a picture just fills a surface."""
    have_m = [side / picture_scale for side in picture.shape[::-1]]
    return max(side / have for side, have in zip(size_m, have_m, strict=True))
