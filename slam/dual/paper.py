"""Dual-SLAM by the paper's text on ORB-SLAM as published: systems ``paper`` and ``paper+``.

Source: Huang et al., "Dual-SLAM", 2020, Sec. III.
"""

from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import ThreadSpec
from dslab.slam.orbslam import orbslam_config, with_settings

PAPER = DualConfig(
    buffer_s=10.0,  # III-A: 10 seconds
    buffer_cap_s=1e6,  # III-A: frames are added until the new map stands
    start_keyframes=2,  # III: from the new map's first frame
    recovery_threads=(ThreadSpec("paper_orb"), ThreadSpec("paper_sift")),  # Algorithm 1
    workers=1,  # III-B: run sequentially
    exhaustive=False,  # III-B: the second one if the first one fails
    relocalization=False,  # the text has none
    place_merging=None,
)
"""Settings of Dual-SLAM."""

SAID: dict[str, str] = {
    "buffer_s": "III-A: 10 seconds",
    "buffer_cap_s": "III-A: frames are added until the new map stands",
    "start_keyframes": "III: from the new map's first frame",
    "recovery_threads": "Algorithm 1",
    "workers": "III-B: run sequentially",
    "exhaustive": "III-B: the second thread if the first one fails",
    "relocalization": "III: none",
    "place_merging": "III: none",
    "THREAD.max_unusable_s": "Algorithm 1, lines 6 and 7: ends at the first frame without a pose",
    "THREAD.whole_buffer": "III-B: all buffer frames",
    "THREAD.at_once": "III-C: after all frames",
    "THREAD.tracking": "III-B: similar to a basic ORB-SLAM",
    "THREAD.mapping": "III-B: similar to a basic ORB-SLAM",
    "THREAD.fusion.confirmations": "III-C: one similarity",
    "THREAD.fusion.min_share": "III-C: none",
    "THREAD.doubt": "III-B: none",
    "SIFT.contrast": "Lowe's threshold of keypoints",
    "SIFT.ratio": "Lowe's ratio of matches",
}
"""Settings that follow the paper's text, and where it stands."""

NO_EFFECT: dict[str, str] = {
    "max_start_noise": "frames have the usual noise",
    "relocalization_maps": "there is no relocalization",
    "THREAD.fusion.max_scale_change": "one similarity",
    "THREAD.fusion.max_rotation_deg": "one similarity",
    "THREAD.fusion.max_shift": "one similarity",
}
"""Settings that decide nothing, and why."""

STAYS: dict[str, str] = {
    "THREAD.fusion.min_candidates": "of 25 pairs of points 20 must fit; III-C gives no number",
    "THREAD.fusion.min_inliers": "the same",
    "THREAD.fusion.min_matches": "the same",
    "THREAD.fusion.max_time_gap_s": "keyframes within .17 s are matched; III-C: of similar numbers",
    "SIFT.min_points": "thread 2 refines its poses by SIFT and ORB features, with 15 map points at least",
    "SIFT.min_features": "20 matches make a pose; Algorithm 1 gives no number",
    "SIFT.min_features_alone": "60 where there are fewer map points",
    "SIFT.young_points": "thread 2 makes keyframes earlier where the map is young",
    "SIFT.min_parallax_deg": "SIFT matches are triangulated from this parallax on",
    "SIFT.depth_radius_px": "before that, a SIFT feature has the depth of the nearest map point within 6 px",
    "SIFT.adjusted_keyframes": "SIFT features are in the adjustment; Algorithm 1, line 20: ORB features",
    "SIFT.paired_keyframes": "new points are sought in the newest keyframes too, whatever they share",
    "SIFT.n_features": "1,000 features an image",
    "SIFT.octaves": "four octaves",
    "SIFT.most_pixels": "images are not doubled first; larger ones are reduced",
    "SIFT.ransac_iterations": "300 samples; Algorithm 1: PnP",
    "SIFT.ransac_error_px": "3 px in these samples",
}
"""Settings that are read and of which the text says nothing, and what they do."""

STAYS_IN_CODE: tuple[str, ...] = (
    "bundle adjustment of a recovery runs in turn with its poses (Algorithm 1: in parallel)",
    "a backward frame that is a keyframe of an old map is always made one",
    "recoveries of several breakages go into any saved map that the buffer reaches; the text knows one",
    "after the similarity the seam is adjusted, and what may be corrupted behind it culled (III-C: a merger)",
    "images wait in the buffer as JPEG for thread 2 (III-A: ORB features)",
)
"""What the text leaves open and code decides."""


def paper_config(camera: PinholeCamera, plus: bool = False) -> SlamConfig:
    """Settings of the base; ``plus``: initialization by GMS (III-D)."""
    config = orbslam_config(camera)
    return with_settings(config, {"initialization.matcher": "gms_alone"}) if plus else config
