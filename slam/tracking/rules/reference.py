"""A first pose without a prediction: by the points of the last reference keyframe."""

from dslab.slam.core.frame import Frame
from dslab.slam.tracking.local_map import match_keyframe
from dslab.slam.tracking.rules.interface import Gate, Tracking

_RATIO = 0.8
"""Best over second best distance of descriptors, without a prediction: that of ORB-SLAM's release."""


def track_reference_keyframe(
    tracking: Tracking, gate: Gate, frame: Frame, last: Frame, least_matches: int, least_inliers: int
) -> bool:
    """Match a frame with the last reference keyframe's points; True if enough hold at the pose by a gate."""
    m = tracking.map
    rows, points = match_keyframe(frame, m, m.live(last.reference_keyframe), _RATIO)
    frame.point[:], frame.area[:] = -1, 0.0
    if len(rows) < least_matches:
        return False
    frame.point[rows], frame.T_cam_map = points, last.T_cam_map.copy()
    return gate.refine(m, frame)[0] >= least_inliers
