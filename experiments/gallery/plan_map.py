"""Map of a path from above, over a horizontal cut through the world at the height of the camera."""

import colorsys
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.sim.worlds.base import WorldModel

SIZE_PX = 480
_DPI = 100
_MARGIN_SHARE, _MARGIN_M = 0.08, 2.0
_GAZE_SHARE = 0.03
_CUTS_BELOW_M = (0.0, 1.0)  # the camera's height, and lower for low objects
_STOREY_M = 2.0  # storeys are farther apart
# The golden angle: neighbours in the list get distant hues.
_HUE_STEP = 137.508 / 360


def kind_colour(kind: str) -> str:
    """Colour of a kind of stress, as in CSS."""
    hue = list(SEGMENT_KINDS).index(kind) * _HUE_STEP % 1
    return "#{:02x}{:02x}{:02x}".format(*(round(255 * c) for c in colorsys.hls_to_rgb(hue, 0.47, 0.75)))


def draw_map(
    file: Path,
    world: WorldModel,
    position_m: np.ndarray,
    segments_m: list[tuple[str, np.ndarray]],
    frames_m: np.ndarray,
    gazes: np.ndarray,
) -> None:
    """Write the map as a PNG file: path, segments, numbered frames with their viewing directions.

    Args:
        file: the file.
        world: the world to cut.
        position_m: (T, 3) positions of the camera.
        segments_m: kind and (n, 3) path of each segment.
        frames_m, gazes: (k, 3) positions and optical axes of the frames that are shown.
    """
    figure = Figure(figsize=(SIZE_PX / _DPI, SIZE_PX / _DPI), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot(aspect="equal", xlabel="m")
    axes.tick_params(labelsize=7)
    low, high = position_m[:, :2].min(axis=0), position_m[:, :2].max(axis=0)
    half = (high - low).max() * (0.5 + _MARGIN_SHARE) + _MARGIN_M
    (left, bottom), (right, top) = (low + high) / 2 - half, (low + high) / 2 + half
    axes.set(xlim=(left, right), ylim=(bottom, top))
    storey = np.floor((position_m[:, 2] - position_m[:, 2].min()) / _STOREY_M)
    for height_m in (float(np.median(position_m[storey == k, 2])) for k in np.unique(storey)):
        for below_m in _CUTS_BELOW_M:
            cut = LineCollection(level_cut(world, height_m - below_m), colors="#999999", linewidths=0.5)
            axes.add_collection(cut, autolim=False)
    for kind, path_m in segments_m:
        axes.plot(*path_m[:, :2].T, color=kind_colour(kind), linewidth=7, alpha=0.6, solid_capstyle="butt")
    axes.plot(*position_m[:, :2].T, color="#266edc", linewidth=1.2)
    for marker, place in (("o", position_m[0]), ("s", position_m[-1])):
        axes.plot(*place[:2], marker, color="#266edc", markerfacecolor="none", markersize=8)
    for number, (at, gaze) in enumerate(zip(frames_m[:, :2], gazes[:, :2], strict=True), 1):
        axes.plot(*np.array([at, at + 2 * _GAZE_SHARE * half * gaze]).T, color="#222222", linewidth=1)
        # Behind the camera, clear of the viewing direction.
        axes.annotate(str(number), at - 2 * _GAZE_SHARE * half * gaze, ha="center", va="center", fontsize=7)
    figure.savefig(file)


def level_cut(world: WorldModel, z_m: float) -> np.ndarray:
    """Ends, (n, 2, 2), of the lines where the world's triangles cross a level."""
    corners = np.concatenate([s.vertices[s.triangles] for s in world.surfaces])
    above_m = corners[..., 2] - z_m
    corners = corners[(above_m.max(axis=1) > 0) & (above_m.min(axis=1) <= 0)]
    ends = np.roll(corners, -1, axis=1)
    from_m, to_m = corners[..., 2] - z_m, ends[..., 2] - z_m
    # A triangle that crosses the level has two sides that cross it.
    crosses = (from_m > 0) != (to_m > 0)
    share = from_m[crosses] / (from_m - to_m)[crosses]
    met = corners[crosses] + share[:, None] * (ends - corners)[crosses]
    return met[:, :2].reshape(-1, 2, 2)
