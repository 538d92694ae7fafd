"""ORB-SLAM as it was published, as settings of the base: the system ``orbslam``.

``PUBLISHED`` says what ORB-SLAM's paper gives, or where it says "enough", notes on its public release.
``NO_EFFECT`` are settings that decide nothing then, ``STAYS`` those that do and for which nothing was
published. A test holds the three against all settings, so that what stays different is a list, not a claim.

Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM: a versatile and accurate monocular SLAM system", IEEE Trans.
Robotics 31(5), 2015; roman numbers are its sections.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple, TypeVar

from dslab.slam.config import SlamConfig, default_config
from dslab.slam.core.camera import PinholeCamera

Settings = TypeVar("Settings")
_ALL = 1_000_000  # no bound


class Published(NamedTuple):
    """A published value and where it stands."""

    value: Any
    source: str


PUBLISHED: dict[str, Published] = {
    "orb.n_features": Published(1000, "V-A; 2,000 in images of KITTI's size"),
    "orb.n_levels": Published(8, "V-A"),
    "orb.scale_factor": Published(1.2, "V-A"),
    "orb.fast_threshold": Published(20, "release; V-A: adapted per cell"),
    "orb.fast_min_threshold": Published(7, "release"),
    "orb.subpixel": Published(False, "V-A: FAST corners"),
    "orb.noise_px": Published(1.0, "IV: a measurement error of 1 pixel"),
    "orb.faint_share": Published(0.0, "V-A: none"),
    "initial_features": Published(2.0, "release"),
    "initialization.min_keypoints": Published(100, "release"),
    "initialization.min_matches": Published(100, "release"),
    "initialization.matcher": Published("windowed", "release; IV-1"),
    "initialization.max_octave": Published(0, "IV-1: only at the finest scale"),
    "initialization.min_points": Published(50, "release"),
    "initialization.max_between": Published(0, "IV: none"),
    "initialization.geometry": Published("published", "IV-2 to IV-4"),
    "initialization.second_motion.max_views": Published(0, "IV: none"),
    "tracking.rules": Published("published", "V-B to V-E, appendix"),
    "tracking.local_map_keyframes": Published(_ALL, "V-D: all that share points, and their neighbours"),
    "tracking.doubt.min_share": Published(0.0, "V: none"),
    "tracking.doubt.nearer": Published(0.0, "V: none"),
    "tracking.doubt.slower": Published(0.0, "V: none"),
    "mapping.rules": Published("published", "VI-C to VI-E"),
    "mapping.neighbours": Published(20, "release; VI-C: the connected keyframes"),
    "mapping.min_baseline": Published(0.01, "release"),
    "mapping.window": Published(_ALL, "VI-D: all connected keyframes"),
    "mapping.fixed": Published(_ALL, "VI-D: all that see the points"),
    "mapping.min_found_share": Published(0.25, "VI-B"),
    "mapping.redundancy": Published(0.9, "VI-E"),
    "belief": Published(None, "V-C, VII: tracking goes on at once, a verified loop is closed"),
    "loops.min_gap": Published(10, "release"),
    "loops.consistency": Published(3, "VII-A"),
    "loops.alignment.min_candidates": Published(20, "release"),
    "loops.alignment.min_inliers": Published(20, "release"),
    "loops.alignment.min_share": Published(0.0, "VII-B: none"),
    "loops.alignment.min_matches": Published(20, "release"),
    "loops.radius_px": Published(10.0, "release"),
    "loops.min_matches": Published(40, "release"),
    "loops.adjustment_iterations": Published(0, "VII-D: the essential graph alone"),
    "relocalization.candidates": Published(_ALL, "V-C: every candidate"),
    "relocalization.last_keyframe": Published(False, "V-C: candidates of the database"),
    "relocalization.local_map_keyframes": Published(1, "V-C: the points of the candidate keyframe"),
    "relocalization.min_margin": Published(0.0, "V-C: none"),
    "rescue.max_s": Published(0.0, "V: none"),
    "self_calibration.at_keyframes": Published((), "a calibrated camera"),
    "min_map_keyframes": Published(5, "release"),
}
"""Settings as published, by their names."""

NO_EFFECT: dict[str, str] = {
    "initialization.gms": "initialization.matcher",
    "initialization.two_view": "initialization.geometry",
    "initialization.second_motion": "initialization.second_motion.max_views",
    "tracking.max_uncertainty": "tracking.rules",
    "tracking.keyframe_information": "tracking.rules",
    "tracking.urgent_information": "tracking.rules",
    "tracking.keyframe_interval_s": "tracking.rules",
    "mapping.max_depth_error": "mapping.rules",
    "tracking.doubt": "tracking.doubt.min_share",
    "relocalization.apart": "relocalization.min_margin",
    "relocalization.apart_deg": "relocalization.min_margin",
    "rescue": "rescue.max_s",
    "self_calibration": "self_calibration.at_keyframes",
}
"""Settings, or groups of them, that decide nothing, and the setting by which that is so."""

STAYS: dict[str, str] = {
    "orb.cell_px": "cells of 30 px; V-A gives no size",
    "initialization.radius_px": "windows of 100 px; IV-1 gives no search",
    "initialization.ratio": "the second best match is no nearer than by .9; IV-1 gives no number",
    "mapping.min_depth": "a new point is no nearer than .1 median depths; VI-C: in front of both cameras",
    "relocalization.ratio": "the second best match is no nearer than by .75; V-C gives no number",
    "relocalization.min_matches": "15 matches with a candidate; V-C gives no number",
    "relocalization.ransac_iterations": "300 samples; V-C: iterations are alternated",
    "relocalization.ransac_error_px": "5 px, as the pose is refined next; V-C gives no number",
    "relocalization.min_pose_inliers": "10 matches make a pose; V-C: enough inliers",
    "relocalization.min_inliers": "50 matches in the end; V-C: enough inliers",
}
"""Settings that are read and were not published, and what stays different by them."""

STAYS_IN_CODE: tuple[str, ...] = (
    "matches without guidance are sought among all features, in place of one node of the vocabulary (III-E)",
    "the vocabulary has 10,000 words of rendered frames, in place of a million of photographs (III-E)",
    "corners are spread by nested grids, in place of a count per cell (V-A)",
    "mapping ends what it has begun when keyframes wait, in place of breaking off bundle adjustment (V-E)",
    "mapping is busy with a keyframe for .384 s, its published median (Table III), in lockstep too (V-E)",
    "relocalization takes poses from three points, in place of EPnP (V-C)",
)
"""What stays different by code that no setting reaches."""


def orbslam_config(camera: PinholeCamera) -> SlamConfig:
    """Settings of ORB-SLAM as published, for the size of a camera's images."""
    config = default_config(camera)
    size = {"orb.n_features": config.orb.n_features}
    return with_settings(config, {name: p.value for name, p in PUBLISHED.items()} | size)


def with_settings(config: Settings, values: Mapping[str, Any]) -> Settings:
    """Copy settings with other values, by names such as ``tracking.doubt.nearer``."""
    changed: dict[str, Any] = {}
    for name, value in values.items():
        group, _, rest = name.partition(".")
        if rest:
            changed[group] = with_settings(changed.get(group, getattr(config, group)), {rest: value})
        else:
            changed[group] = value
    return replace(config, **changed)  # pyright: ignore[reportArgumentType, reportCallIssue]


def names_of(config: Any, prefix: str = "") -> list[str]:
    """Names of all settings of a group, in their order; a group that is None has but its own name."""
    names = []
    for f in fields(config):
        value = getattr(config, f.name)
        names += names_of(value, f"{prefix}{f.name}.") if is_dataclass(value) else [prefix + f.name]
    return names
