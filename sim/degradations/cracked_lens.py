"""Cracked lens: cracks in the glass before it scatter and bend the light."""

from dataclasses import dataclass

import cv2
import numpy as np

from dslab.scenarios.segments import CrackedLens
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

_STEP_DEG, _WANDER = 0.8, 0.12  # of the pieces of a crack, and how they turn, radians
_BRANCH_SHARE, _BRANCH_TURN = 0.12, (0.5, 1.4)  # per piece; radians off the crack
_WIDTH_DEG = 0.11  # where a crack hides half of the light; the glass is near and not in focus
_REACH_DEG = 1.5  # over which the bending by a crack fades
_CRUSHED_DEG = 1.0  # of the point of impact
# Light of a crack relative to that about it, how it changes along the crack, and of its two sides.
_GLINT, _GLINT_STEP, _FACETS = (0.5, 1.5), 0.12, 0.6
_SMEAR = 16  # light is smeared on a grid this much coarser than the image
_FELT_SHARE = 0.02


@dataclass(frozen=True)
class _Pieces:
    """Straight pieces of cracks.

    Attributes:
        begin, end: (n, 2) float64, pixels.
        glint: (n,) light relative to that about it.
        bend: (n,) how far it bends the light, -1 to 1 of the most.
    """

    begin: np.ndarray
    end: np.ndarray
    glint: np.ndarray
    bend: np.ndarray

    def __len__(self) -> int:
        return len(self.begin)


class CrackedLensDegradation(ImageDegradation[CrackedLens]):
    """Draws cracks that start at a point of impact and grow one after the other.

    A crack shows light from all about it, brighter or darker by its facets. Beside it the glass is tilted and
    moves the image away from the crack or towards it.
    """

    kind = "cracked_lens"
    stage = Stage.LENS
    measure_name = "cracked_share"

    def prepare(self, segment: CrackedLens, camera: Intrinsics, streams: Streams) -> Filter:
        return _Cracked(segment, camera, streams)

    def threshold(self, segment: CrackedLens) -> float:
        """A fiftieth of the view, which a few cracks hide."""
        return _FELT_SHARE


class _Cracked:
    """The cracks of one segment, drawn anew as they grow."""

    def __init__(self, segment: CrackedLens, camera: Intrinsics, streams: Streams) -> None:
        self._segment, self._camera = segment, camera
        size_px = np.array([camera.width_px, camera.height_px])
        rng = streams("impact")
        self._impact, self._first_rad = size_px * rng.uniform(0.25, 0.75, 2), rng.uniform(0, 2 * np.pi)
        self._streams, self._strength = streams, 0.0

    def __call__(self, image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
        if view.strength * self._segment.cracks == 0:
            return image, 0.0
        if view.strength != self._strength:
            self._grow(view.strength)
            self._strength = view.strength
        light = cv2.remap(decode(image), self._at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        height, width = image.shape
        small = cv2.resize(light, (-(-width // _SMEAR), -(-height // _SMEAR)), interpolation=cv2.INTER_AREA)
        smeared = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
        return encode(light + self._hidden * (self._glint * smeared - light)), self._share

    def _grow(self, strength: float) -> None:
        """Draw the cracks that there are at a strength."""
        camera, pieces = self._camera, self._pieces(strength * self._segment.cracks)
        px_per_deg = np.radians(1) * camera.fx
        y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(np.float32)
        piece, distance_px = _nearest_piece(pieces, x.shape)
        way = pieces.end - pieces.begin
        along = (way / np.maximum(np.hypot(*way.T), 1e-9)[:, None]).astype(np.float32)
        across_x, across_y = -along[piece, 1], along[piece, 0]
        side = np.sign(across_x * (x - pieces.begin[piece, 0]) + across_y * (y - pieces.begin[piece, 1]))
        fades = np.exp(-distance_px / np.float32(_REACH_DEG * px_per_deg))
        bend_px = self._segment.bend_deg * px_per_deg * pieces.bend[piece] * side * fades
        self._at = np.dstack([x + bend_px * across_x, y + bend_px * across_y]).astype(np.float32)
        width_px = max(_WIDTH_DEG * px_per_deg, 0.5)
        crack = np.exp2(-((distance_px / width_px) ** 2))
        from_impact = np.hypot(x - self._impact[0], y - self._impact[1]) / (_CRUSHED_DEG * px_per_deg)
        crushed = min(1.0, strength * self._segment.cracks) * np.exp2(-(from_impact**2))
        self._hidden = np.maximum(crack, crushed).astype(np.float32)
        self._glint = (pieces.glint[piece] * (1 + _FACETS * side)).astype(np.float32)
        self._share = float((self._hidden > 0.5).mean())

    def _pieces(self, cracks: float) -> _Pieces:
        """The pieces of a number of cracks, the last of them not yet as long as it will be."""
        rows: list[np.ndarray] = []
        for number in range(int(np.ceil(cracks))):
            own = self._crack(number)
            rows.append(own[: max(1, int(len(own) * min(1.0, cracks - number)))])
        table = np.concatenate(rows)
        return _Pieces(table[:, :2], table[:, 2:4], table[:, 4], table[:, 5])

    def _crack(self, number: int) -> np.ndarray:
        """(n, 6) pieces of a crack with its branches: begin, end, glint and bend."""
        rng, camera = self._streams("crack", number), self._camera
        step_px = max(1.0, _STEP_DEG * np.radians(1) * camera.fx)
        # By the golden angle, cracks share the directions evenly, however many there are.
        heading = self._first_rad + number * np.pi * (3 - np.sqrt(5)) + rng.normal(0, 0.15)
        longest = np.hypot(camera.width_px, camera.height_px) / step_px
        steps = int(longest * rng.uniform(0.25, 1))
        rows = _walk(rng, self._impact, heading, steps, step_px)
        for at in np.flatnonzero(rng.random(len(rows)) < _BRANCH_SHARE):
            turn = rng.uniform(*_BRANCH_TURN) * rng.choice([-1, 1])
            branch = int(rng.uniform(2, 4 + 0.3 * at))
            rows = np.concatenate([rows, _walk(rng, rows[at, 2:4], rows[at, 6] + turn, branch, step_px)])
        return rows[:, :6]


def _walk(
    rng: np.random.Generator, begin: np.ndarray, heading: float, steps: int, step_px: float
) -> np.ndarray:
    """(steps, 7) pieces of a wandering line: begin, end, glint, bend and heading."""
    headings = heading + np.cumsum(rng.normal(0, _WANDER, steps))
    way = step_px * rng.uniform(0.6, 1.4, (steps, 1)) * np.column_stack([np.cos(headings), np.sin(headings)])
    end = begin + np.cumsum(way, axis=0)
    glint = rng.uniform(*_GLINT) * np.exp(np.cumsum(rng.normal(0, _GLINT_STEP, steps)))
    bend = np.full(steps, rng.uniform(-1, 1))
    return np.column_stack([end - way, end, glint, bend, headings])


def _nearest_piece(pieces: _Pieces, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) int index of the piece nearest to each pixel, and (H, W) float32 distance in pixels."""
    number = np.zeros(size, np.float32)
    ends = np.rint(np.stack([pieces.begin, pieces.end], 1) * 16).astype(int)
    for index, (begin, end) in enumerate(ends.tolist()):
        cv2.line(number, begin, end, float(index + 1), 1, cv2.LINE_8, 4)
    drawn = number > 0
    if not drawn.any():
        return np.zeros(size, int), np.full(size, np.inf, np.float32)
    free = (~drawn).astype(np.uint8)
    distance_px, label = cv2.distanceTransformWithLabels(
        free, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    piece_of = np.zeros(int(label.max()) + 1, int)
    piece_of[label[drawn]] = number[drawn].astype(int) - 1
    return piece_of[label], distance_px
