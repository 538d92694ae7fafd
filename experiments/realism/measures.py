"""The quantities that are compared, each a distribution over frames, observations or map points."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Measure:
    """One quantity.

    Attributes:
        name: its key in the JSON file.
        label: axis label, with the unit.
        meaning: what it says, in a sentence.
        low, high: ends of the plotted axis; values beyond are counted in the outermost bins.
        bins: number of bins between them.
        log: bins of about equal ratio instead of equal width.
        group: ``images``, ``matches`` or ``map``.
        whole: values are whole numbers; then every bin holds at least one.
    """

    name: str
    label: str
    meaning: str
    low: float
    high: float
    bins: int
    log: bool = False
    group: str = "matches"
    whole: bool = False

    def edges(self) -> np.ndarray:
        """(n + 1,) float64 edges; n is ``bins``, or fewer for whole numbers."""
        if self.log and self.whole:
            return np.unique(np.rint(np.geomspace(self.low, self.high, self.bins + 1))) - 0.5
        if self.log:
            return np.geomspace(self.low, self.high, self.bins + 1)
        return np.linspace(self.low, self.high, self.bins + 1)

    def histogram(self, values: np.ndarray) -> np.ndarray:
        """(n,) float64 share of the values in each bin; zeros without values."""
        edges = self.edges()
        counts = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]
        return counts / max(len(values), 1)


MEASURES: tuple[Measure, ...] = (
    Measure(
        "noise", "noise in even areas, grey levels", "Standard deviation of the finest detail where a frame "
        "is even; needs even areas, so texture everywhere raises it too.", 0, 4, 40, group="images",
    ),
    Measure(
        "sharpness", "contrast of one pixel over that of two", "Share of the fine detail: root mean square "
        "Laplacian of the frame over that of the frame at half size. Blur of lens and sensor lowers it.",
        0, 1.5, 45, group="images",
    ),
    Measure(
        "clipped_dark", "pixels of level 5 or less, share", "Shadows without detail.", 0, 0.3, 30,
        group="images",
    ),
    Measure(
        "clipped_bright", "pixels of level 250 or more, share", "Sky and lights without detail.", 0, 0.3, 30,
        group="images",
    ),
    Measure(
        "corner_strength", "strength of corners (FAST), grey levels", "Contrast of corners over 7 levels.",
        7, 150, 24, True, "images", True,
    ),
    Measure(
        "empty_tiles", "tiles without a corner over 20 levels, share", "Tiles of an eighth of the width: "
        "texture that is everywhere leaves none empty.", 0, 1, 33, group="images",
    ),
    Measure(
        "outliers", "matches per frame that do not fit its pose, share", "1 - inliers / matches of every "
        "tracked frame.", 0, 0.6, 40,
    ),
    Measure("inliers", "inliers per frame", "Matches that fit the pose of a tracked frame.", 0, 1000, 40),
    Measure(
        "descriptor_distance", "descriptor distance of an observation to its point, bits", "How much a "
        "thing's look changes from view to view.", 0, 100, 50,
    ),
    Measure(
        "octave_change", "octave of an observation less the one predicted by distance", "How far the size at "
        "which a corner is found follows from its distance.", -4.5, 4.5, 9,
    ),
    Measure(
        "residual", "reprojection residual, in sigma of its octave", "Of all observations of the finished "
        "map; it ends at 2.45, from where an observation is removed.", 0, 3, 45,
    ),
    Measure(
        "live_residual", "distance of a match from its point, in sigma of its octave", "Of all matches in "
        "windows of three times the tracker's, at the pose that was found, none removed.", 0, 8, 48,
    ),
    Measure(
        "track_length", "keyframes that observe a point", "Of all points of the finished map.", 1, 60, 24,
        True, "map", True,
    ),
    Measure(
        "found", "times found over times expected", "Of all points: whether they are seen again where they "
        "should be.", 0, 1, 40, group="map",
    ),
    Measure(
        "relative_depth", "depth of an observation over its keyframe's median", "Near things tell of "
        "translation, far ones of rotation alone.", 0.1, 10, 40, True, "map",
    ),
)  # fmt: skip
"""Every quantity, in the order of the page."""
