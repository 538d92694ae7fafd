"""Initialisation: the first map, from two views with enough parallax."""

from collections import deque
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from slam.core.camera import PinholeCamera
from slam.core.frame import Frame
from slam.core.geometry import ViewGeometry, share_of_motion
from slam.core.timing import StageTimer
from slam.initialization.two_view import TwoViewConfig, two_view_reconstruction
from slam.map import _map_kernels as kernels
from slam.map.map import Map
from slam.mapping.local_mapping import LocalMapper, LocalMappingConfig
from slam.matching.gms import GmsConfig
from slam.matching.initial import GmsMatcher, InitialMatcher, MatcherKind, WindowedMatcher
from slam.tracking.tracker import Tracker, TrackingConfig


@dataclass(frozen=True)
class InitializationConfig:
    """Settings of the two-view initialisation.

    Attributes:
        min_keypoints: a frame with fewer is no reference.
        min_matches: fewer matches with the reference frame make the present one the new reference.
        matcher: how frames are matched: ``windowed`` near each keypoint's last known place, or ``gms`` also
            anywhere else, where its neighbours move along.
        radius_px: half side of the search window.
        max_octave: coarsest pyramid level matched by ``windowed``; by ``gms`` it is that of its settings.
        ratio: best over second best descriptor distance within the window at the most.
        gms: settings of ``gms``.
        min_points: map points that the first bundle adjustment must leave.
        max_between: frames between the two views that are kept, to be placed once the map stands.
        two_view: settings of the geometry.
    """

    min_keypoints: int = 100
    min_matches: int = 100
    matcher: MatcherKind = "windowed"
    radius_px: float = 100.0
    max_octave: int = 2
    ratio: float = 0.9
    gms: GmsConfig = field(default_factory=GmsConfig)
    min_points: int = 50
    max_between: int = 100
    two_view: TwoViewConfig = field(default_factory=TwoViewConfig)

    def __post_init__(self) -> None:
        known = get_args(MatcherKind)
        if self.matcher not in known:
            raise ValueError(f"unknown matcher {self.matcher!r}: one of {', '.join(known)}")


@dataclass(frozen=True)
class InitialMap:
    """A fresh two-view map.

    Attributes:
        map: of two keyframes.
        first, second: their frames, tracked.
        between: the last frames between them, features only, oldest first.
        model: what explained the two views.
        points: map points.
    """

    map: Map
    first: Frame
    second: Frame
    between: tuple[Frame, ...]
    model: str
    points: int


class Initializer:
    """Seeks two frames that a map can start from.

    Attributes:
        reference: the frame that later ones are matched with, None while there is none.
    """

    def __init__(self, camera: PinholeCamera, view: ViewGeometry, config: InitializationConfig) -> None:
        self.camera = camera
        self.view = view
        self.config = config
        self.reference: Frame | None = None
        self._matcher = _matcher(camera, view, config)
        self._between: deque[Frame] = deque(maxlen=config.max_between)

    def reset(self) -> None:
        """Forget the reference frame."""
        self.reference = None

    def offer(
        self, frame: Frame, map_id: int, rng: np.random.Generator, mapping: LocalMappingConfig
    ) -> tuple[InitialMap | None, str, int]:
        """Try to start a map from the reference frame and this one.

        Args:
            frame: features only.
            map_id: number of the map to be.
            rng: stream of the two-view RANSAC.
            mapping: settings of the first bundle adjustment.

        Returns:
            The map or None, the reason where there is none, and the matches found.
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
        return InitialMap(built, first, second, tuple(self._between), geometry.model, points), "", count

    def _take_reference(self, frame: Frame) -> None:
        self.reference = frame
        self._between.clear()
        self._matcher.start(frame.features)


def frames_between(initial: InitialMap, config: TrackingConfig) -> list[Frame]:
    """The frames between the two views that track back from the second to the first, as far as it goes.

    It is done in a copy of the map, so that the map is as if they had never been.

    Args:
        initial: as :meth:`Initializer.offer` gives it.
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
    if config.matcher == "gms":
        return GmsMatcher(camera, view, config.radius_px, config.ratio, config.gms)
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
    """Two keyframes and the points between them; the first camera is the map's origin."""
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
        view.scale,
    )
    return built


def _refine(built: Map, mapping: LocalMappingConfig) -> int:
    """Bundle adjustment of both keyframes, then unit median depth; the points left."""
    LocalMapper(built, mapping).adjust_keyframes(np.array([False, True]))
    depth = kernels.median_depth(built.arrays, 0)
    if depth <= 0:
        return 0
    built.transform(1.0 / depth, np.eye(3), np.zeros(3))
    return len(built.points())


def _tracked(built: Map, frame: Frame, keyframe: int) -> Frame:
    """The frame as tracked in the new map."""
    tracked = Frame(frame.features)
    tracked.point[:] = built.observed_points(keyframe)
    tracked.T_cam_map = built.T_cam_map(keyframe)
    tracked.reference_keyframe = keyframe
    tracked.T_cam_reference = np.eye(4)
    return tracked
