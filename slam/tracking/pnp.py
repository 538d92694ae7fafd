"""Camera pose from 3D-2D matches with outliers (PnP in RANSAC)."""

import cv2
import numpy as np

from dslab.slam.core.geometry import ViewGeometry


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
    """Estimate the pose with most inliers by RANSAC.

    Args:
        xyz: (n, 3) points, frame map.
        xy: (n, 2) their undistorted keypoints, px.
        view: intrinsics.
        rng: seeds the RANSAC.
        iterations: most RANSAC iterations.
        error_px: largest reprojection error of an inlier.
        min_inliers: fewest inliers of an accepted pose.
        method: OpenCV's flag of the minimal solver.
        confidence: probability of having drawn the best pose, at which RANSAC stops.

    Returns:
        T_cam_map (4, 4) and the inlier mask (n,) bool; None if no pose is accepted, or the points coincide.

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
    # Unlike the final step of OpenCV's RANSAC, SQPnP handles coplanar points.
    try:
        solved, rotation, translation = cv2.solvePnP(xyz[agree], xy[agree], K, None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:  # It refuses points without extent, as those of a map that has collapsed.
        return None
    if not solved:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rotation)[0], translation.ravel()
    return (T, agree) if np.isfinite(T).all() else None
