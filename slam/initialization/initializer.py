"""Initialisation of a map from two views with enough parallax."""

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import ViewGeometry, share_of_motion
from dslab.slam.core.settings import setting, settings
from dslab.slam.core.timing import StageTimer
from dslab.slam.initialization.published import published_reconstruction
from dslab.slam.initialization.second_motion import SecondMotion, SecondMotionConfig
from dslab.slam.initialization.two_view import TwoViewConfig, TwoViewResult, two_view_reconstruction
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.mapping.local_mapping import LocalMapper, LocalMappingConfig
from dslab.slam.matching.gms import GmsConfig
from dslab.slam.matching.initial import GmsMatcher, InitialMatcher, MatcherKind, WindowedMatcher
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.tracker import Tracker


@settings
class InitializationConfig:
    """Settings of the two-view initialisation."""

    min_keypoints: int = setting(100, "fewest keypoints of a reference frame")
    min_matches: int = setting(100, "with fewer, the current frame becomes the reference")
    matcher: MatcherKind = setting(
        "windowed", "windowed: near each keypoint; gms: also elsewhere; gms_alone: only so"
    )
    radius_px: float = setting(100.0, "half side of the search window")
    max_octave: int = setting(2, "coarsest pyramid level matched by windowed; gms has its own setting")
    ratio: float = setting(0.9, "best over second best descriptor distance in the window", le=1)
    gms: GmsConfig = setting(GmsConfig(), "matching of two whole frames")
    min_points: int = setting(50, "fewest map points left after the first bundle adjustment")
    max_between: int = setting(100, "most frames kept between the two views, tracked afterwards")
    geometry: Literal["own", "published"] = setting("own", "of two views; published: as ORB-SLAM's text says")
    two_view: TwoViewConfig = setting(TwoViewConfig(), "settings of our own")
    second_motion: SecondMotionConfig = setting(SecondMotionConfig(), "judgement of another motion")


@dataclass(frozen=True)
class InitialMap:
    """A new two-view map.

    Attributes:
        map: the map with two keyframes.
        first, second: their frames, tracked.
        between: the last frames between them, features only, oldest first.
        model: the geometry that explained the two views.
        points: number of map points.
        second_motion: the other motion that explains the two views nearly as well, if there is one.
    """

    map: Map
    first: Frame
    second: Frame
    between: tuple[Frame, ...]
    model: str
    points: int
    second_motion: SecondMotion | None = None


class Initializer:
    """Finds two frames from which a map can be initialized.

    Attributes:
        reference: the frame with which later ones are matched, None without one.
    """

    def __init__(self, camera: PinholeCamera, view: ViewGeometry, config: InitializationConfig) -> None:
        self.camera = camera
        self.view = view
        self.config = config
        self.reference: Frame | None = None
        self._matcher = _matcher(camera, view, config)
        self._between: deque[Frame] = deque(maxlen=config.max_between)

    def reset(self) -> None:
        """Discard the reference frame."""
        self.reference = None

    def offer(
        self, frame: Frame, map_id: int, rng: np.random.Generator, mapping: LocalMappingConfig
    ) -> tuple[InitialMap | None, str, int]:
        """Try to start a map from the reference frame and this one.

        Args:
            frame: features only.
            map_id: id of the new map.
            rng: stream of the two-view RANSAC.
            mapping: settings of the first bundle adjustment.

        Returns:
            The map or None, the reason of a failure, and the number of matches.
        """
        if len(frame.features) < self.config.min_keypoints:
            self.reference = None
            return None, "too_few_keypoints", 0
        if self.reference is None:
            self._take_reference(frame)
            return None, "reference_frame", 0
        rows_1, rows_2 = self._matcher.match(frame.features).T
        count = len(rows_1)
        if count < self.config.min_matches:
            self._take_reference(frame)
            return None, "too_few_matches", count
        pixels_1 = np.ascontiguousarray(self.reference.features.xy[rows_1])
        pixels_2 = np.ascontiguousarray(frame.features.xy[rows_2])
        if self.config.geometry == "published":
            geometry = published_reconstruction(pixels_1, pixels_2, self.camera.K, rng)
        else:
            noise = self.view.scale[self.reference.features.octave[rows_1]]
            geometry = two_view_reconstruction(
                pixels_1, pixels_2, self.camera.K, rng, self.config.two_view, noise
            )
        if not geometry.success:
            self._between.append(frame)
            return None, geometry.reason, count
        keep = geometry.triangulated
        built = _build_map(
            map_id,
            self.view,
            self.reference,
            frame,
            geometry.T_2_1,
            geometry.points[keep],
            rows_1[keep],
            rows_2[keep],
        )
        points = _refine(built, mapping)
        if points < self.config.min_points:
            self._take_reference(frame)
            return None, "few_points_after_adjustment", count
        first = _tracked(built, self.reference, 0)
        second = _tracked(built, frame, 1)
        self.reset()
        judged = self._second_motion(geometry, first, second)
        initial = InitialMap(built, first, second, tuple(self._between), geometry.model, points, judged)
        return initial, "", count

    def _second_motion(self, geometry: TwoViewResult, first: Frame, second: Frame) -> SecondMotion | None:
        config, rival = self.config.second_motion, geometry.T_2_1_rival
        if rival is None or config.max_views == 0 or geometry.lead_sigmas >= config.sure_lead_sigmas:
            return None
        T_2_1 = second.T_cam_map @ np.linalg.inv(first.T_cam_map)
        return SecondMotion(self.view, first, second, T_2_1, rival, config)

    def _take_reference(self, frame: Frame) -> None:
        self.reference = frame
        self._between.clear()
        self._matcher.start(frame.features)


def frames_between(initial: InitialMap, config: TrackingConfig) -> list[Frame]:
    """Track the frames between the two views, from the second backward until one fails.

    Tracking uses a copy of the map; the map itself is left unchanged.

    Args:
        initial: result of :meth:`Initializer.offer`.
        config: settings of the tracker.

    Returns:
        Tracked frames, newest first.
    """
    map_, first, second = initial.map.copy(), initial.first, initial.second
    steps = second.features.index - first.features.index
    motion = map_.T_cam_map(0) @ np.linalg.inv(map_.T_cam_map(1))
    tracker = Tracker(map_, config, StageTimer())
    tracker.start(second.copy(), 1, share_of_motion(motion, 1.0 / steps))
    placed = []
    for frame in reversed(initial.between):
        if not tracker.track(frame).success:
            break
        placed.append(frame)
    return placed


def _matcher(camera: PinholeCamera, view: ViewGeometry, config: InitializationConfig) -> InitialMatcher:
    if config.matcher != "windowed":
        alone = config.matcher == "gms_alone"
        return GmsMatcher(camera, view, config.radius_px, config.ratio, config.gms, alone)
    return WindowedMatcher(view, config.radius_px, config.max_octave, config.ratio)


def _build_map(
    map_id: int,
    view: ViewGeometry,
    frame_1: Frame,
    frame_2: Frame,
    T_2_1: np.ndarray,
    points: np.ndarray,
    rows_1: np.ndarray,
    rows_2: np.ndarray,
) -> Map:
    """Build a map of two keyframes and their points; the first is the origin."""
    built = Map(map_id, view)
    frames = (Frame(frame_1.features), Frame(frame_2.features))
    for frame, T in zip(frames, (np.eye(4), T_2_1), strict=True):
        frame.T_cam_map = T
        built.add_keyframe(frame, -1 if T is not T_2_1 else 0)
    start_2 = built.keypoints(1).start
    first = built.reserve_points(len(points))
    kernels.create_points(
        built.arrays,
        first,
        np.ascontiguousarray(points),
        rows_1.astype(np.int32),
        (rows_2 + start_2).astype(np.int32),
        view,
    )
    return built


def _refine(built: Map, mapping: LocalMappingConfig) -> int:
    """Bundle-adjust both keyframes and scale to unit median depth; number of points left."""
    LocalMapper(built, mapping).adjust_keyframes(np.array([False, True]))
    depth = kernels.median_depth(built.arrays, 0)
    if depth <= 0:
        return 0
    built.transform(1.0 / depth, np.eye(3), np.zeros(3))
    return len(built.points())


def _tracked(built: Map, frame: Frame, keyframe: int) -> Frame:
    """Return the frame as tracked in the new map."""
    tracked = Frame(frame.features)
    tracked.point[:] = built.observed_points(keyframe)
    tracked.T_cam_map = built.T_cam_map(keyframe)
    tracked.reference_keyframe = keyframe
    tracked.T_cam_reference = np.eye(4)
    return tracked
