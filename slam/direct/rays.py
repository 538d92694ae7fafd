"""Depth along a ray: what a view of known motion says of the inverse depth of a pixel.

A pixel of a host view has a ray; its inverse depth has a mean and a variance. Another view sees the ray as a
line. The pattern about the pixel is compared with the places on the line from the mean less three standard
deviations to the mean plus three, in steps of a pixel at most, and the best place is refined.

**Variance of a place.** Let G be the sum of w g gᵀ over the pattern, g its gradients in the view, e the unit
vector along the line and n that across it. If the view's pose is wrong by so much that its points lie off by
δ, the residuals of a pattern shifted by s along the line are gᵀ(s e + δ) and noise. Least squares over s
gives s = -(eᵀGδ + eᵀ Σ w g noise) / eᵀGe. With noise of variance σ² and δ of variance ω² in each direction

    var(s) = σ² / eᵀGe + ω² (1 + (eᵀGn / eᵀGe)²).

Residuals of an aligned frame are noise of the light, σ = ``LEAST_NOISE``, and of places that are off, which
grows with the gradient: ω² = (E - σ²) / mean(|g|²) for the frame's mean square residual E. A pattern's
residuals have the variance σ² + ω² |g|² of its own gradients.
For a single edge the last factor is one over the squared cosine between its gradient and the line.

**Floor.** Noise differs from look to look and averages out. A pose is wrong for all points alike, and poses
come from one map: the second term does not average out. The filter's variance does not fall below the least
second term of its looks.

**Distinctness.** The likelihood of the best place over that of the best one elsewhere is
exp((C₂ - C₁) / 2τ²) for costs C, sums of weighted squared residuals of variance τ² = σ² + ω²|g|². Where it
is below ``DISTINCT``, the look says nothing.

**Right or wrong.** Residuals of the same surface deviate by τ, those of another by what two unlike patterns
of the host differ by, υ. If the mean log-odds of a pixel at the best place, log(υ/τ) - r²/2τ² + r²/2υ², are
negative, the surface is not there. Looks are counted; with an even prior the inlier probability has the mean
(right + 1) / (right + wrong + 2).

Source: derived here. An inverse depth with an inlier probability is as in Vogiatzis, Hernández, "Video-based,
Real-time Multi-view Stereo", 2011, Sec. 3; the pattern and its weights as in Engel, Koltun, Cremers, "Direct
Sparse Odometry", 2018, Sec. 2.2.
"""

import numpy as np

POSE_PX = 0.1
"""Least ω, px: a tenth of a pixel is what interpolation leaves of a place."""
DISTINCT = 20.0
"""Of twenty places that are as much likelier than the best elsewhere, one is wrong at most."""
LEAST_NOISE = 1.0
"""Least σ, grey levels: two views are rounded to whole ones, and interpolated."""
RIPE_PX = 1.0
"""Largest standard deviation on the line of the last look with which a depth is good enough to begin with:
what linear interpolation of an image reaches."""


def unlike(intensity: np.ndarray) -> float:
    """Root mean square difference of unlike patterns: of each with another far from it in the list.

    Args:
        intensity: (N, 8) of the patterns of one view, in the order of their places.
    """
    if len(intensity) < 2:
        return np.inf
    return float(np.sqrt(np.mean((intensity - np.roll(intensity, len(intensity) // 2, axis=0)) ** 2)))
