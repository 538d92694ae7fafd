"""Placement of a view by a reference: photometric alignment that is believed, through motion blur too.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.slam.core.settings import GREY, setting, settings
from dslab.slam.direct.alignment import Aligned, PhotometricAlignmentConfig, Reference, align
from dslab.slam.direct.blur import align_through_blur
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.direct.turn import level_of, turn_between

_SPEEDS = (0.65, 0.8, 1.25, 1.5)  # of the predicted motion over a gap that are tried too
_LONG_GAP = 3
_MOST_SPREAD_CHANGE = 4.0


@settings
class PlacementConfig:
    """Settings of the placement of a view."""

    alignment: PhotometricAlignmentConfig = setting(PhotometricAlignmentConfig(), "photometric alignment")
    most_error: float = setting(9.0, "error of an alignment beyond which the images differ", unit=GREY)
    most_saturated: float = setting(0.25, "share of residuals beyond the cutoff that is too many", le=1)
    least_likeness: float = setting(0.5, "correlation of views, below which they differ", le=1)
    least_visible: float = setting(0.25, "share of the reference's points that must be in view", le=1)
    through_blur: bool = setting(True, "compare a sharp image with a blurred one by blurring it")
    blurred_error: float = setting(8.0, "error beyond which an image and a blurred one differ", unit=GREY)
    blurred_share: float = setting(0.65, "largest error through blur, over that without", le=1)

    def looks_alike(self, found: Aligned) -> bool:
        """True if two views, aligned as they are, look alike."""
        return (
            found.error <= self.most_error
            and found.saturated <= self.most_saturated
            and found.likeness >= self.least_likeness
        )


@dataclass(frozen=True)
class Placement:
    """Placement of a view.

    Attributes:
        found: the alignment; None without one.
        sharp: the images look alike as they are, so that their points can be found again.
        reason: why there is none: ``images_differ`` or ``too_little_in_view``.
    """

    found: Aligned | None
    sharp: bool = False
    reason: str = ""


def place(
    view: Reference,
    xyz: np.ndarray,
    source: ImagePyramid,
    target: ImagePyramid,
    rectifier: Rectifier,
    velocity: np.ndarray | None,
    guesses: Sequence[np.ndarray],
    config: PlacementConfig,
) -> Placement:
    """Place a view by a reference.

    Args:
        view: the reference, points of the source.
        xyz: (N, 3) these points in the source's camera.
        source, target: the images.
        rectifier: that made them.
        velocity: (4, 4) motion per frame, along which images are blurred; None where unknown.
        guesses: (4, 4) motions, source to target, to which the turn of the whole image is added.
        config: what is believed.
    """
    level = level_of(target)
    images = (pyramid.levels[level][..., 0] for pyramid in (source, target))
    guesses = [*guesses, turn_between(*images, rectifier.intrinsics[level])]
    found = align(view, target, guesses)
    sharp = found is not None and config.looks_alike(found)
    if not sharp:
        found = _through_blur(view, xyz, source, target, rectifier, velocity, guesses, found, config)
    if found is None:
        return Placement(None, reason="images_differ")
    if found.visible < config.least_visible or not _keeps_spread(xyz, found.T_target_ref):
        return Placement(None, reason="too_little_in_view")
    return Placement(found, sharp)


def guesses_ahead(velocity: np.ndarray | None, gap: int) -> list[np.ndarray]:
    """Motions over ``gap`` frames that are tried: at constant velocity, other speeds, none.

    Args:
        velocity: (4, 4) motion of one frame; None for none.
        gap: number of frames.
    """
    velocity = velocity if velocity is not None else np.eye(4)
    steps = [gap] + [max(1, round(gap * speed)) for speed in _SPEEDS if gap > _LONG_GAP]
    ahead = [np.linalg.matrix_power(velocity, step) for step in steps]
    return [*ahead, np.eye(4)]


def _through_blur(
    view: Reference,
    xyz: np.ndarray,
    source: ImagePyramid,
    target: ImagePyramid,
    rectifier: Rectifier,
    velocity: np.ndarray | None,
    guesses: Sequence[np.ndarray],
    sharp: Aligned | None,
    config: PlacementConfig,
) -> Aligned | None:
    """The alignment with the sharper image blurred along the motion; None where this explains little."""
    if not config.through_blur or velocity is None:
        return None
    found = align_through_blur(view, source, target, rectifier, xyz, velocity, guesses)
    if found is None or (sharp is not None and found.error > config.blurred_share * sharp.error):
        return None
    alike = found.likeness >= config.least_likeness
    return found if alike and found.error <= config.blurred_error else None


def _keeps_spread(xyz: np.ndarray, T_target_ref: np.ndarray) -> bool:
    """False if points (n, 3) of the reference shrink to a patch in the target, which fits many."""
    moved = xyz @ T_target_ref[:3, :3].T + T_target_ref[:3, 3]
    ahead = moved[:, 2] > 0
    if ahead.sum() < len(xyz) / 2:
        return False
    areas = [float(np.prod(np.std(p[ahead, :2] / p[ahead, 2:], axis=0))) for p in (xyz, moved)]
    return areas[0] <= _MOST_SPREAD_CHANGE * areas[1]
