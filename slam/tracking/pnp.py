"""A camera's pose from map points and where it sees them, many of which may be wrong."""

import cv2
import numpy as np

from slam.core.geometry import ViewGeometry


def ransac_pnp(
    xyz: np.ndarray,
    xy: np.ndarray,
    view: ViewGeometry,
    rng: np.random.Generator,
    iterations: int,
    error_px: float,
    min_inliers: int,
    method: int = cv2.SOLVEPNP_EPNP,
    confidence: float = 0.999,
) -> tuple[np.ndarray, np.ndarray] | None:
    """The pose that most matches agree with, by RANSAC.

    Args:
        xyz: (n, 3) points, frame map.
        xy: (n, 2) their undistorted keypoints, px.
        view: intrinsics.
        rng: seeds the RANSAC.
        iterations: of the RANSAC at the most.
        error_px: reprojection error up to which a match agrees.
        min_inliers: matches that must agree.
        method: OpenCV's number of the solver of each sample.
        confidence: that the best pose has been drawn, at which it stops.

    Returns:
        T_cam_map (4, 4) and (n,) bool which agree; None where there is no such pose.

    Source: Lepetit, Moreno-Noguer, Fua, "EPnP", 2009.
    """
    if len(xyz) < max(min_inliers, 6):
        return None
    K = np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1.0]])
    xyz, xy = np.ascontiguousarray(xyz, np.float64), np.ascontiguousarray(xy, np.float64)
    cv2.setRNGSeed(int(rng.integers(2**31)))
    found, _, _, inliers = cv2.solvePnPRansac(
        xyz,
        xy,
        K,
        None,
        iterationsCount=iterations,
        reprojectionError=error_px,
        confidence=confidence,
        flags=method,
    )
    if not found or inliers is None or len(inliers) < min_inliers:
        return None
    agree = np.zeros(len(xyz), np.bool_)
    agree[inliers.ravel()] = True
    # SQPnP, unlike the closing step of the RANSAC, takes points in a plane as well as any.
    solved, rotation, translation = cv2.solvePnP(xyz[agree], xy[agree], K, None, flags=cv2.SOLVEPNP_SQPNP)
    if not solved:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rotation)[0], translation.ravel()
    return (T, agree) if np.isfinite(T).all() else None
