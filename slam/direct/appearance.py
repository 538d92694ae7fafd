"""Does a surface, rendered as patches, look like another view of it?

Under the right motion the patches about a view's points are seen again in another view where the motion says,
and not beside it. Under a wrong one they are seen there no more often than anywhere.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dslab.slam.direct._alignment_kernels import sample_patterns
from dslab.slam.direct._appearance_kernels import correlations
from dslab.slam.direct.pyramid import ImagePyramid

_SIDE = 5
_PATCH = np.array(
    [[x, y] for y in range(-(_SIDE // 2), _SIDE // 2 + 1) for x in range(-(_SIDE // 2), _SIDE // 2 + 1)],
    float,
)  # (25, 2) right, down
_BESIDE_PX = 8.0
_ROUND = np.arange(8) * (np.pi / 4)
_OFFSETS = np.concatenate([np.zeros((1, 2)), _BESIDE_PX * np.column_stack([np.cos(_ROUND), np.sin(_ROUND)])])
_LEVEL = 1  # of the pyramid: errors of a pixel or two of the image must not tell
_REACH_PX = 1
_LEAST_CONTRAST = 2.0
_GRADIENT_SCALE = 50.0


@dataclass(frozen=True)
class Surface:
    """Points of a view with depth, rendered as patches.

    Attributes:
        pyramid: of the view.
        xy: (N, 2) pixels of the finest level.
        inverse_depth: (N,) in the view's length unit, positive.
    """

    pyramid: ImagePyramid
    xy: np.ndarray
    inverse_depth: np.ndarray


@dataclass(frozen=True)
class Appearance:
    """How a surface looks in another view.

    Attributes:
        told: number of patches that are in view and tell something.
        alike: share of these that look alike where they should be.
        chance: that share beside these places.
    """

    told: int
    alike: float
    chance: float

    @property
    def excess(self) -> float:
        """Share of the patches that look alike beyond chance: 1 for all of them, 0 for no more than that."""
        return (self.alike - self.chance) / max(1.0 - self.chance, 1e-9) if self.told else 0.0


def compare(
    surface: Surface, view: ImagePyramid, intrinsics: np.ndarray, T_view_surface: np.ndarray, least: float
) -> Appearance:
    """Compare a surface with another view of it; gain, offset and shading do not matter.

    Args:
        surface: the surface.
        view: the other view, of the same camera.
        intrinsics: (L, 4) of the levels.
        T_view_surface: (4, 4) motion, in the surface's length unit.
        least: correlation from which a patch looks alike.
    """
    best = _correlations(surface, view, intrinsics, T_view_surface)
    alike = best[np.isfinite(best).all(axis=1)] >= least
    if not len(alike):
        return Appearance(0, 0.0, 0.0)
    return Appearance(len(alike), float(alike[:, 0].mean()), float(alike[:, 1:].mean()))


def alike_in(
    surface: Surface, view: ImagePyramid, intrinsics: np.ndarray, T_view_surface: np.ndarray, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) bool: which points of a surface tell something in a view, and which look alike there.

    Arguments as for :func:`compare`.
    """
    best = _correlations(surface, view, intrinsics, T_view_surface)
    return np.asarray(np.isfinite(best).all(axis=1)), best[:, 0] >= least


def _correlations(
    surface: Surface, view: ImagePyramid, intrinsics: np.ndarray, T_view_surface: np.ndarray
) -> np.ndarray:
    """(N, 9) correlation of every patch where it should be seen and beside, NaN where it cannot be told."""
    level = min(_LEVEL, len(view) - 1)
    uv = np.ascontiguousarray((surface.xy + 0.5) * 0.5**level - 0.5, float)
    intensity, weight = np.empty((len(uv), len(_PATCH))), np.empty((len(uv), len(_PATCH)))
    sample_patterns(surface.pyramid.levels[level], uv, _PATCH, _GRADIENT_SCALE, intensity, weight)
    intensity[weight <= 0] = np.nan
    best = np.empty((len(uv), len(_OFFSETS)))
    correlations(
        view.levels[level], intrinsics[level], uv, np.ascontiguousarray(surface.inverse_depth, float), _PATCH,
        intensity, np.ascontiguousarray(T_view_surface), _OFFSETS, _REACH_PX, _LEAST_CONTRAST, best,
    )  # fmt: skip
    return best


def pooled(looks: Iterable[Appearance]) -> Appearance:
    """Several comparisons as one, every patch counted once."""
    known = [look for look in looks if look.told]
    told = sum(look.told for look in known)
    if not told:
        return Appearance(0, 0.0, 0.0)
    return Appearance(
        told,
        sum(look.told * look.alike for look in known) / told,
        sum(look.told * look.chance for look in known) / told,
    )
