"""Holes of measured depth images."""

import cv2
import numpy as np

from dslab.sim.sensors.camera import Intrinsics

_NARROW_DEG = 3.0
"""Half of the width of the widest hole that is filled, visual angle."""


def fill_narrow_holes(depth_m: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Give narrow holes the depth of the nearest pixel that has one; wide ones stay.

    A depth sensor leaves holes along outlines and on dark or shiny surfaces, which are as near as what is
    about them. Where nothing is within its reach, such as the sky, the hole is wide.

    Args:
        depth_m: (H, W) float32, 0 for none; left unchanged.
        camera: intrinsics of the image.

    Returns:
        (H, W) float32; the given image if it has no hole or no depth.
    """
    hole = depth_m <= 0
    if not hole.any() or hole.all():
        return depth_m
    distance_px, label = cv2.distanceTransformWithLabels(
        hole.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    count, hole_of = cv2.connectedComponents(hole.astype(np.uint8), connectivity=4)
    half_px = np.zeros(count, np.float32)
    np.maximum.at(half_px, hole_of[hole], distance_px[hole])
    narrow = hole & (half_px[hole_of] <= np.radians(_NARROW_DEG) * camera.fx)
    depth_of = np.zeros(int(label.max()) + 1, np.float32)
    depth_of[label[~hole]] = depth_m[~hole]
    return np.where(narrow, depth_of[label], depth_m)
