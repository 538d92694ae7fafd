"""Marginalisation: which keyframes and points leave a window, and what they leave behind.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.3 and 3.1.
"""

import numpy as np

from dslab.slam.core.geometry import camera_centre
from dslab.slam.ldso.adjustment import affine_prior
from dslab.slam.ldso.config import PhotometricConfig
from dslab.slam.ldso.model import model_of
from dslab.slam.ldso.window import PARAMETERS, Window

_LEAST_GOOD = 3  # residuals of a point that is marginalised, not dropped, now or ever
_TINY = 1e-5


def leaving(window: Window, T_cam_map: np.ndarray) -> list[int]:
    """Slots of keyframes that leave when a new one comes; the two newest and it stay (Sec. 3.1).

    Those leave whose points are hardly in its view. If there are still too many, the one that is near to
    others and far from the new one.

    Args:
        window: before the new keyframe.
        T_cam_map: (4, 4) pose of the new keyframe.
    """
    config = window.config
    in_view = share_in_view(window, T_cam_map)
    out = [s for s in window.slots[:-1] if in_view[s] < config.least_in_view]
    out = out[: max(0, len(window) - config.fewest)]
    while len(window) - len(out) >= config.most:
        out.append(_farthest(window, [s for s in window.slots if s not in out], T_cam_map))
    return out


def share_in_view(window: Window, T_cam_map: np.ndarray) -> np.ndarray:
    """(S,) share of the active points that a keyframe ever had that are in a camera's view; 0 without."""
    points = window.active
    fx, fy, cx, cy = window.intrinsics[0]
    height, width = window.images.shape[1:3]
    T = (T_cam_map @ np.linalg.inv(window.T_cam_map))[points.host]
    rays = np.column_stack([(points.uv - [cx, cy]) / [fx, fy], np.ones(len(points))])
    X = np.einsum("nij,nj->ni", T[:, :3, :3], rays) + T[:, :3, 3] * points.inverse_depth[:, None]
    X[X[:, 2] <= 1e-6] = np.nan
    uv = X[:, :2] / X[:, 2:] * [fx, fy] + [cx, cy]
    inside = ((uv >= 0) & (uv < [width, height])).all(axis=1)
    of_each = np.bincount(points.host, minlength=window.size) + window.gone
    return np.bincount(points.host, inside, minlength=window.size) / np.maximum(of_each, 1)


def _farthest(window: Window, slots: list[int], T_cam_map: np.ndarray) -> int:
    """The keyframe, the newest left out, of the largest distance score (Sec. 3.1)."""
    new = camera_centre(T_cam_map)
    centres = {s: camera_centre(window.T_cam_map[s]) for s in slots}
    unit = np.mean([np.linalg.norm(new - c) for c in centres.values()]) + 1e-12

    def score(slot: int) -> float:
        to_others = sum(
            1.0 / (_TINY + np.linalg.norm(centres[slot] - centres[other]) / unit)
            for other in slots
            if other != slot
        )
        return float(np.sqrt(np.linalg.norm(new - centres[slot]) / unit) * to_others)

    return max(slots[:-1], key=score)


def remove_points(window: Window, out: list[int], photometric: PhotometricConfig) -> None:
    """Marginalise or drop the points of leaving keyframes and those that are out of view.

    Keyframes keep their points that are marginalised.

    Args:
        window: changed.
        out: slots of the keyframes that leave.
        photometric: settings.
    """
    p = window.active
    good = (p.seen == 1).sum(axis=1)
    useless = (good == 0) | ~(p.inverse_depth > 0)
    newest = window.slots[-2:]
    unseen = (p.seen[:, newest] != 1).all(axis=1) & ~np.isin(p.host, newest)
    lose_all = good - (p.seen[:, out] == 1).sum(axis=1) < 1 if out else np.zeros(len(p), bool)
    removed = ~useless & (unseen | lose_all | np.isin(p.host, out))
    kept_as_prior = removed & (good >= 1) & (p.observed >= _LEAST_GOOD)
    kept_as_prior &= p.information > window.config.margin_information
    if kept_as_prior.any():
        _marginalise_points(window, kept_as_prior, photometric)
    window.keep_points(kept_as_prior)
    window.drop_points(useless | removed)


def _marginalise_points(window: Window, rows: np.ndarray, photometric: PhotometricConfig) -> None:
    points = window.active.of(rows)
    model = model_of(window, points, points.seen == 1, photometric.huber)
    off_H, off_b = model.eliminated()
    H, b = model.H - off_H, model.b - off_b
    weight = window.config.margin_weight
    window.prior_H += weight * H
    window.prior_b += weight * (b - H @ window.delta.ravel())


def remove_keyframe(window: Window, slot: int, photometric: PhotometricConfig) -> None:
    """Marginalise a keyframe whose points have left; what is known of it stays with the others."""
    information, pull = affine_prior(window, photometric)
    own = np.arange(PARAMETERS * slot, PARAMETERS * (slot + 1))
    H, b = window.prior_H, window.prior_b
    H[own, own] += information[own]
    b[own] += pull[own] - information[own] * window.delta.ravel()[own]
    window.prior_H, window.prior_b = without(H, b, own)
    window.remove(slot)


def without(H: np.ndarray, b: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A quadratic form with some parameters minimised out; their rows are zero.

    Args:
        H, b: (n, n) and (n,) information and half the gradient.
        rows: indices of the parameters.
    """
    H, b = H.copy(), b.copy()
    scale = np.sqrt(np.maximum(H[rows, rows], 1e-12))
    inner = np.linalg.pinv(H[np.ix_(rows, rows)] / scale / scale[:, None], rcond=1e-10, hermitian=True)
    inner = inner / scale / scale[:, None]
    rest = np.setdiff1d(np.arange(len(b)), rows)
    link = H[np.ix_(rest, rows)]
    H[np.ix_(rest, rest)] -= link @ inner @ link.T
    b[rest] -= link @ inner @ b[rows]
    H[rows], H[:, rows], b[rows] = 0.0, 0.0, 0.0
    return 0.5 * (H + H.T), b
