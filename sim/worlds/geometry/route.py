"""Straight lines and polylines: their length, and rounded corners."""

from dataclasses import dataclass

import numpy as np

_ARC_STEP_RAD = np.pi / 12


@dataclass(frozen=True, eq=False)
class Stretch:
    """A straight line in plan.

    Attributes:
        start, end: (2,) float64, metres.
    """

    start: np.ndarray
    end: np.ndarray

    @property
    def length_m(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    @property
    def way(self) -> np.ndarray:
        """(2,) unit vector along it."""
        return (self.end - self.start) / self.length_m

    @property
    def left(self) -> np.ndarray:
        """(2,) unit vector to the left of ``way``."""
        return np.array([-self.way[1], self.way[0]])

    def point(self, along_m: float, left_m: float = 0.0) -> np.ndarray:
        """(2,) plan position."""
        return self.start + along_m * self.way + left_m * self.left


def arc_length(line: np.ndarray) -> np.ndarray:
    """(M,) cumulative length along a line of (M, 2) or (M, 3) points, from 0."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def rounded(corners: np.ndarray, radius_m: float, closed: bool) -> np.ndarray:
    """A polyline whose corners are replaced by arcs tangent to both sides.

    Args:
        corners: (M, 2) float64, metres.
        radius_m: of every arc; a side must be at least as long as the two tangents on it.
        closed: the last corner joins the first.

    Returns:
        (K, 2) float64; a closed one ends where it starts.
    """
    count = len(corners)
    points = [] if closed else [corners[:1]]
    for k in range(count) if closed else range(1, count - 1):
        before, corner, after = corners[k - 1], corners[k], corners[(k + 1) % count]
        points.append(arc(before, corner, after, radius_m))
    points.append(points[0][:1] if closed else corners[-1:])
    return np.concatenate(points)


def arc(before: np.ndarray, corner: np.ndarray, after: np.ndarray, radius_m: float) -> np.ndarray:
    """(K, 2) points of the arc that rounds one corner, both tangent points included."""
    incoming, outgoing = (corner - before, after - corner)
    incoming, outgoing = incoming / np.linalg.norm(incoming), outgoing / np.linalg.norm(outgoing)
    turn = np.arctan2(incoming[0] * outgoing[1] - incoming[1] * outgoing[0], incoming @ outgoing)
    start = corner - radius_m * np.tan(abs(turn) / 2) * incoming
    angles = np.linspace(0.0, turn, max(2, int(np.ceil(abs(turn) / _ARC_STEP_RAD)) + 1))
    left = np.array([-incoming[1], incoming[0]]) * np.sign(turn)
    along, aside = radius_m * np.sin(np.abs(angles)), radius_m * (1 - np.cos(angles))
    return start + along[:, None] * incoming + aside[:, None] * left
