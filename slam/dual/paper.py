"""Dual-SLAM near the paper's text: systems ``paper`` and ``paper+``.

Settings are the paper's or ORB-SLAM's where there is one. What has none stays: docs/dual-slam.md lists it.

Source: paper, Sec. III; Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015.
"""

from dataclasses import replace

from dslab.slam.config import SlamConfig, default_config
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import ThreadSpec

PAPER = DualConfig(
    buffer_s=10.0,
    buffer_cap_s=1e6,
    start_keyframes=2,
    recovery_threads=(ThreadSpec("paper_orb"), ThreadSpec("paper_sift")),
    workers=1,
    relocalization=False,
    place_merging=None,
)
"""Settings of Dual-SLAM."""


def paper_config(camera: PinholeCamera, plus: bool = False) -> SlamConfig:
    """Settings of the base, ORB-SLAM's published ones; ``plus``: initialization by GMS."""
    config = default_config(camera)
    start, tracking = config.initialization, config.tracking
    return replace(
        config,
        orb=replace(config.orb, subpixel=False, noise_px=1.0, faint_share=0.0),
        initial_features=2.0,
        initialization=replace(
            start,
            matcher="gms_alone" if plus else "windowed",
            max_octave=0,
            max_between=0,
            two_view=replace(start.two_view, min_lead_sigmas=0.0, homography_share=0.45),
            second_motion=replace(start.second_motion, max_views=0),
        ),
        tracking=replace(
            tracking,
            urgent_share=tracking.keyframe_share,
            urgent_inliers=0,
            keyframe_cover=0.0,
            max_noise=1.0,
            crossing=replace(tracking.crossing, min_expected=1e6),
            doubt=replace(tracking.doubt, min_share=0.0, nearer=0.0, slower=0.0),
        ),
        mapping=replace(config.mapping, min_parallax_deg=1.15, depth_around=0, robust_iterations=5),
        self_calibration=replace(config.self_calibration, at_keyframes=()),
    )
