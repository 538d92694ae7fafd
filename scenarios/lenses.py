"""Rays through a distorting lens, and the check that there is one for every pixel."""

import math

import numpy as np

MOST_HALF_ANGLE_DEG = 78.0
"""A pinhole image of a wider lens would be absurdly large."""

_COLUMNS, _ROWS = 41, 31
_ROUNDS, _SOLVED = 30, 1e-10  # negligible error of a normalised point
_AT_ONCE = 1 << 14


def lens_fault(
    size_px: tuple[int, int],
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    model: str,
    coefficients: tuple[float, ...],
) -> tuple[str, str] | None:
    """Problem and remedy of a lens without a ray for every pixel; None for a sound one.

    Args:
        size_px: width and height of the image.
        focal_px: fx and fy.
        centre_px: principal point; integer coordinates are pixel centres.
        model: ``radtan``, ``rational`` or ``equidistant``.
        coefficients: of the model, in OpenCV's order.
    """
    if sees_too_far(size_px, focal_px, centre_px, model, coefficients):
        problem = f"the lens sees more than {MOST_HALF_ANGLE_DEG:g} degrees to the side"
        return problem, "give a longer focal length, or a narrower lens"
    width, height = size_px
    grid = np.meshgrid(np.linspace(-0.5, width - 0.5, _COLUMNS), np.linspace(-0.5, height - 0.5, _ROWS))
    bent = (np.stack(grid, axis=-1).reshape(-1, 2) - centre_px) / focal_px
    return ray_fault(straightened(bent, model, coefficients), coefficients)


def sees_too_far(
    size_px: tuple[int, int],
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    model: str,
    coefficients: tuple[float, ...],
) -> bool:
    """True for a fisheye lens whose image reaches beyond ``MOST_HALF_ANGLE_DEG``, if it is sound up to there.

    Arguments as of ``lens_fault``.
    """
    if model != "equidistant":
        return False
    t = np.radians(np.linspace(0, MOST_HALF_ANGLE_DEG, 100))
    powers = np.array([1, *coefficients]) * t[:, None] ** np.arange(1, 10, 2)
    radius = powers.sum(axis=1)
    far = np.maximum(np.add(centre_px, 0.5), np.subtract(size_px, centre_px) - 0.5) / focal_px
    return bool((np.diff(radius) > 0).all() and np.hypot(*far) > radius[-1])


def ray_fault(rays: np.ndarray, coefficients: tuple[float, ...]) -> tuple[str, str] | None:
    """Problem and remedy of a lens with these (N, 2) rays, NaN for none; None for a sound one."""
    if not np.isfinite(rays).all():
        shown = ", ".join(f"{value:g}" for value in coefficients)
        problem = f"the lens ({shown}) folds the image over itself or sees behind the camera"
        return problem, "give the coefficients of a calibration"
    widest_deg = math.degrees(math.atan(np.hypot(*rays.T).max()))
    if widest_deg > MOST_HALF_ANGLE_DEG:
        problem = f"the lens sees {widest_deg:.0f} degrees to the side"
        return problem, f"give one of at most {MOST_HALF_ANGLE_DEG:g}"
    return None


def straightened(bent: np.ndarray, model: str, coefficients: tuple[float, ...]) -> np.ndarray:
    """Remove OpenCV's distortion from normalised points, by Newton's method.

    Args:
        bent: (N, 2) distorted points at unit depth.
        model: ``radtan``, ``rational`` or ``equidistant``.
        coefficients: of the model, in OpenCV's order.

    Returns:
        (N, 2) float64 rays at unit depth, NaN where there is none, it points backward, or the lens has folded
        the image before it.
    """
    straighten = _straighten_equidistant if model == "equidistant" else _straighten_rational
    parts = np.array_split(bent, len(bent) // _AT_ONCE + 1)
    with np.errstate(all="ignore"):
        return np.concatenate([straighten(part, coefficients) for part in parts])


def _straighten_rational(bent: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """The model radtan is the rational one without its last three coefficients."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, 0.0, 0.0, 0.0)[:8]
    x, y = bent.T.copy()
    sound = np.zeros(len(bent), bool)
    for _ in range(_ROUNDS):
        r2 = x * x + y * y
        above, below = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        slope_above, slope_below = k1 + r2 * (2 * k2 + r2 * 3 * k3), k4 + r2 * (2 * k5 + r2 * 3 * k6)
        radial = above / below
        growth = 2 * ((slope_above * below - above * slope_below) / (below * below))
        error_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - bent[:, 0]
        error_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - bent[:, 1]
        xx = radial + growth * x * x + 2 * p1 * y + 6 * p2 * x
        xy = growth * x * y + 2 * p1 * x + 2 * p2 * y
        yy = radial + growth * y * y + 6 * p1 * y + 2 * p2 * x
        determinant = xx * yy - xy * xy
        solved = np.abs(error_x) + np.abs(error_y) < _SOLVED
        # Beyond a fold the image is inverted.
        sound = solved & (determinant > 0) & (radial > 0) & (below > 0)
        if solved.all():
            break
        x = np.where(solved, x, x - (yy * error_x - xy * error_y) / determinant)
        y = np.where(solved, y, y - (xx * error_y - xy * error_x) / determinant)
    return np.where(sound[:, None], np.stack([x, y], axis=1), np.nan)


def _straighten_equidistant(bent: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    k1, k2, k3, k4 = coefficients
    radius = np.sqrt(bent[:, 0] * bent[:, 0] + bent[:, 1] * bent[:, 1])
    theta = np.minimum(radius, 1.0)
    sound = np.zeros(len(bent), bool)
    for _ in range(_ROUNDS):
        t2 = theta * theta
        error = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) - radius
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        solved = np.abs(error) < _SOLVED
        sound = solved & (slope > 0) & (theta >= 0) & (theta < np.pi / 2)
        if solved.all():
            break
        theta = np.where(solved, theta, theta - error / slope)
    stretch = np.where(radius > 1e-9, np.tan(theta) / np.maximum(radius, 1e-9), 1.0)
    return np.where(sound[:, None], bent * stretch[:, None], np.nan)
