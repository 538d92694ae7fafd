"""Photometric alignment: the motion between two views under which pixels of known depth look alike.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dslab.slam.core.settings import GREY, setting, settings
from dslab.slam.direct._alignment_kernels import (
    PATTERN,
    advance,
    damped_system,
    likeness,
    mean_cost_model,
    mean_costs,
    residual_bound,
    residual_energy,
    sample_patterns,
)
from dslab.slam.direct.pyramid import ImagePyramid

_SPACING_PX = 2  # of points on the coarser levels, where more would see the same pixels
_DAMPING = 1e-2
_LEAST_DAMPING = 1e-6
_LEAST_INFORMATION = 1e-9
_LEAST_CONTRAST = 0.5
_LARGE_GAIN = 0.3  # as a logarithm
_LARGE_OFFSET = 30.0
_STILL_PX = 0.02  # a smaller step is none
_MOST_RESIDUAL = 255.0


@settings
class PhotometricAlignmentConfig:
    """Settings of photometric alignment."""

    huber: float = setting(9.0, "residual beyond which it counts linearly", unit=GREY, gt=0)
    gradient_scale: float = setting(
        50.0, "gradient at which a residual counts half", unit="grey levels per px", gt=0
    )
    cutoff: float = setting(20.0, "residual beyond which a pixel shows something else", unit=GREY, gt=0)
    iterations: int = setting(12, "most steps on a level")
    gain_sigma: float = setting(0.3, "expected logarithm of the gain between two images", gt=0)
    offset_sigma: float = setting(20.0, "expected offset of brightness between two images", unit=GREY, gt=0)
    tried: int = setting(3, "most guesses of the motion that are followed from the coarsest level on")

    @cached_property
    def affine_prior(self) -> np.ndarray:
        """(2,) information on a and b in units of the residuals' variance."""
        return self.huber**2 / np.array([self.gain_sigma, self.offset_sigma]) ** 2


@dataclass(frozen=True)
class Patterns:
    """Points of a view at one level of its pyramid.

    Attributes:
        uv: (N, 2) float64 pixels of the level.
        inverse_depth: (N,) float64.
        intensity, weight: (N, 8) float64 of the pixels of the pattern.
    """

    uv: np.ndarray
    inverse_depth: np.ndarray
    intensity: np.ndarray
    weight: np.ndarray

    @cached_property
    def known(self) -> int:
        """Number of pixels that the reference shows."""
        return int((self.weight > 0).sum())

    @property
    def least_pixels(self) -> float:
        """Fewest pixels that both views must have: an alignment that looks away from most has low costs."""
        return max(100.0, 0.1 * self.known)


class Reference:
    """A view with points of known depth, ready to be aligned with others.

    Args:
        pyramid: of the view.
        intrinsics: (L, 4) of its levels.
        xy: (N, 2) pixels of the finest level.
        inverse_depth: (N,) in its own length unit, positive.
        config: settings.
    """

    def __init__(
        self,
        pyramid: ImagePyramid,
        intrinsics: np.ndarray,
        xy: np.ndarray,
        inverse_depth: np.ndarray,
        config: PhotometricAlignmentConfig | None = None,
    ) -> None:
        self.intrinsics = intrinsics
        self.config = config or PhotometricAlignmentConfig()
        self.depth = 1.0 / float(np.median(inverse_depth)) if len(inverse_depth) else np.nan
        self._mean, self._contrast = _moments(pyramid)
        self.levels: tuple[Patterns, ...] = tuple(
            self._sampled(image, *_at_level(xy, inverse_depth, level))
            for level, image in enumerate(pyramid.levels)
        )

    def __len__(self) -> int:
        return len(self.levels[0].uv)

    def brightness_of(self, other: ImagePyramid) -> np.ndarray:
        """(2,) a and b by which mean and contrast of the whole images differ."""
        mean, contrast = _moments(other)
        if min(contrast, self._contrast) < _LEAST_CONTRAST:
            return np.zeros(2)
        gain = contrast / self._contrast
        return np.array([np.log(gain), mean - gain * self._mean])

    def coarser(self) -> "Reference":
        """The same without the finest level."""
        return self._with(self.levels[1:], self.intrinsics[1:])

    def seen_in(self, pyramid: ImagePyramid) -> "Reference":
        """The same points in another image of the same view."""
        levels = zip(pyramid.levels, self.levels, strict=True)
        return self._with(
            tuple(self._sampled(image, p.uv, p.inverse_depth) for image, p in levels), self.intrinsics
        )

    def _with(self, levels: tuple[Patterns, ...], intrinsics: np.ndarray) -> "Reference":
        other = copy(self)
        other.levels, other.intrinsics = levels, intrinsics
        return other

    def _sampled(self, image: np.ndarray, uv: np.ndarray, inverse_depth: np.ndarray) -> Patterns:
        intensity, weight = np.empty((len(uv), len(PATTERN))), np.empty((len(uv), len(PATTERN)))
        sample_patterns(image, uv, PATTERN, self.config.gradient_scale, intensity, weight)
        return Patterns(uv, inverse_depth, intensity, weight)


def _moments(pyramid: ImagePyramid) -> tuple[float, float]:
    """Mean and standard deviation of the coarsest level."""
    known = pyramid.levels[-1][..., 0]
    known = known[np.isfinite(known)]
    return (float(known.mean()), float(known.std())) if known.size else (0.0, 0.0)


def _at_level(xy: np.ndarray, inverse_depth: np.ndarray, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and inverse depths of the points that are used on a level."""
    uv = (np.asarray(xy, float) + 0.5) * 0.5**level - 0.5
    kept = np.arange(len(uv)) if level == 0 else _spaced(uv)
    return np.ascontiguousarray(uv[kept]), np.ascontiguousarray(inverse_depth[kept], float)


def _spaced(uv: np.ndarray) -> np.ndarray:
    """Rows of the first point of every small square of pixels."""
    squares = np.floor(uv / _SPACING_PX).astype(np.int64)
    _, first = np.unique(squares[:, 1] << 32 | squares[:, 0] & 0xFFFFFFFF, return_index=True)
    return np.sort(first)


@dataclass(frozen=True)
class Aligned:
    """A photometric alignment.

    Attributes:
        T_target_ref: (4, 4) motion, reference camera to target camera.
        affine: (2,) a, b: target intensity is exp(a) times the reference's plus b.
        error: root of the mean weighted Huber cost on the finest level, of 255.
        visible: share of the reference's pixels that the target shows.
        saturated: share of these whose residual is beyond the cutoff.
        likeness: correlation of the two views within the patterns on the finest level, -1 to 1.
        information: (6, 6) of translation and rotation at the result, brightness taken out, for residuals of
            unit variance.
    """

    T_target_ref: np.ndarray
    affine: np.ndarray
    error: float
    visible: float
    saturated: float
    likeness: float
    information: np.ndarray


def align(
    reference: Reference,
    target: ImagePyramid,
    guesses: Sequence[np.ndarray],
    affine: np.ndarray | None = None,
    coarsest: int | None = None,
    finest: int = 0,
) -> Aligned | None:
    """Align a view with a reference, coarse to fine.

    Args:
        reference: view with depths.
        target: pyramid of the other view, of the same camera.
        guesses: (4, 4) motions reference to target that are tried.
        affine: (2,) brightness at first; None for no change, or that of the whole images if it is large.
        coarsest, finest: levels to begin and to end with; the whole pyramid by default.

    Returns:
        The alignment; None if the views have too little in common to determine one.
    """
    config, levels = reference.config, len(target)
    top = levels - 1 if coarsest is None else min(coarsest, levels - 1)
    start = np.asarray(_first_brightness(reference, target) if affine is None else affine, float)
    states = [_State(np.array(T, float), start.copy()) for T in guesses]
    states = _best(reference, target, states, top, config.tried)
    for level in range(top, finest - 1, -1):
        for state in states:
            state.refine(reference, target, level)
        states = _best(reference, target, states, level, 1 if level == top else len(states))
        if not states:
            return None
    return states[0].result(reference, target, finest)


class _Model(NamedTuple):
    """Half of the summed costs of an alignment as a quadratic form of a step: (8, 8) and (8,)."""

    H: np.ndarray
    gradient: np.ndarray

    @classmethod
    def empty(cls) -> "_Model":
        return cls(np.empty((8, 8)), np.empty(8))


class _Level(NamedTuple):
    """One level of a view and its reference, in the order of the kernels' arguments."""

    image: np.ndarray
    intrinsics: np.ndarray
    uv: np.ndarray
    inverse_depth: np.ndarray
    pattern: np.ndarray
    intensity: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, reference: Reference, target: ImagePyramid, level: int) -> "_Level":
        p = reference.levels[level]
        return cls(
            target.levels[level], reference.intrinsics[level], p.uv, p.inverse_depth, PATTERN, p.intensity,
            p.weight,
        )  # fmt: skip


def _first_brightness(reference: Reference, target: ImagePyramid) -> np.ndarray:
    whole = reference.brightness_of(target)
    return whole if abs(whole[0]) > _LARGE_GAIN or abs(whole[1]) > _LARGE_OFFSET else np.zeros(2)


class _State:
    """An alignment under way."""

    def __init__(self, T: np.ndarray, affine: np.ndarray) -> None:
        self.T = T
        self.affine = affine

    def refine(self, reference: Reference, target: ImagePyramid, level: int) -> None:
        """Levenberg steps on one level."""
        config, views = reference.config, _Level.of(reference, target, level)
        cutoff = residual_bound(*views, self.T, self.affine, config.huber)
        costs = (config.huber, cutoff, config.affine_prior)
        least = reference.levels[level].least_pixels
        scale = np.append(np.full(3, reference.depth), np.ones(5))  # steps of position are in depths
        still = _STILL_PX / reference.intrinsics[level][0]
        model, system, progress = _Model.empty(), _Model.empty(), np.array([np.inf, _DAMPING])
        progress[0] = mean_cost_model(*views, self.T, self.affine, *costs, least, *model)
        damped_system(*model, scale, _DAMPING, _LEAST_INFORMATION, *system)
        bounds = (_LEAST_DAMPING, _LEAST_INFORMATION, still)
        there, results = (self.T, self.affine), (progress, *model, *system)
        for _ in range(config.iterations):
            solution = np.linalg.solve(*system)
            if advance(*views, *there, solution, *costs, least, scale, *bounds, *results):
                break

    def result(self, reference: Reference, target: ImagePyramid, level: int) -> Aligned:
        config, patterns = reference.config, reference.levels[level]
        views, costs = _Level.of(reference, target, level), (config.huber, config.cutoff)
        energy, seen, saturated = residual_energy(*views, self.T, self.affine, *costs)
        H, gradient = _Model.empty()
        prior, least = config.affine_prior, patterns.least_pixels
        mean_cost_model(*views, self.T, self.affine, *costs, prior, least, H, gradient)
        inner = H[6:, 6:] + 1e-9 * np.eye(2)
        information = H[:6, :6] - H[:6, 6:] @ np.linalg.solve(inner, H[6:, :6])
        return Aligned(
            self.T,
            self.affine,
            float(np.sqrt(energy / max(1, seen))),
            seen / max(1, patterns.known),
            saturated / max(1, seen),
            float(likeness(*views, self.T)),
            information,
        )


def _best(
    reference: Reference, target: ImagePyramid, states: list[_State], level: int, most: int
) -> list[_State]:
    """The states of least mean cost, those without enough pixels left out."""
    config = reference.config
    costs = mean_costs(
        *_Level.of(reference, target, level),
        np.array([state.T for state in states]).reshape(-1, 4, 4),
        np.array([state.affine for state in states]).reshape(-1, 2),
        config.huber,
        _MOST_RESIDUAL,
        config.affine_prior,
        reference.levels[level].least_pixels,
    )
    order = [i for i in np.argsort(costs, kind="stable") if np.isfinite(costs[i])]
    return [states[i] for i in order[:most]]
