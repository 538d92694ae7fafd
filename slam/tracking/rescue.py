"""Rescue of a frame that features do not track: its pose by the intensities of the last keyframes.

Where features blur, pixels may still tell. The frame is aligned with a keyframe whose map points give depth
to the pixels near them. Only poses come of it: no keyframe is made of a rescued frame.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import share_of_motion
from dslab.slam.core.settings import setting, settings
from dslab.slam.core.timing import StageTimer
from dslab.slam.direct.alignment import Reference
from dslab.slam.direct.placement import PlacementConfig, place
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.direct.selection import SelectionConfig, select
from dslab.slam.features.tracks import TrackedFrame, take_depth_from_points
from dslab.slam.map.map import Map
from dslab.slam.tracking.tracker import Tracker, TrackingOutcome

_STEADY = 6  # frames over which the motion is taken: steps between two rescued frames are too uncertain


@settings
class RescueConfig:
    """Settings of rescue by intensities."""

    max_s: float = setting(0.0, "longest time from the last frame that features tracked; 0 for no rescue")
    keyframes: int = setting(2, "newest keyframes that a frame is compared with")
    selection: SelectionConfig = setting(SelectionConfig(points=1500), "selection of their pixels")
    depth_radius_px: float = setting(10.0, "largest distance to a keypoint that gives depth")
    min_points: int = setting(60, "fewest pixels with a depth")
    placement: PlacementConfig = setting(PlacementConfig(), "what is believed")


@dataclass(frozen=True)
class Rescued:
    """Pose of a frame by intensities.

    Attributes:
        T_cam_map: (4, 4) pose.
        keyframe: row of the keyframe that it was compared with.
        velocity: (4, 4) motion per frame, over the last frames.
    """

    T_cam_map: np.ndarray
    keyframe: int
    velocity: np.ndarray


class Rescue:
    """Keeps the images of the newest keyframes, and places frames by them.

    Args:
        camera: of the images.
        config: settings.

    Attributes:
        frames: number of frames rescued since features tracked the last one.
    """

    def __init__(self, camera: PinholeCamera, config: RescueConfig) -> None:
        self.config = config
        self.frames = 0
        self._camera = camera
        self._rectifier = Rectifier(camera)
        self._newest: deque[tuple[Map, Frame, np.ndarray]] = deque(maxlen=config.keyframes)
        self._path: deque[Frame] = deque(maxlen=_STEADY)
        self._map: Map | None = None  # of the path
        self._tracked_s = -np.inf

    def go_on(
        self,
        frame: Frame,
        image: np.ndarray,
        outcome: TrackingOutcome,
        tracker: Tracker,
        camera: PinholeCamera,
        timer: StageTimer,
        emit: Callable[..., None],
    ) -> TrackingOutcome:
        """Try to place a frame that ``tracker`` has not, before a breakage is declared; the outcome then."""
        first, found = self.frames == 0, None
        if not (outcome.success or tracker.doubt.reason):
            with timer("rescue"):
                found = self.attempt(frame, image, camera, tracker.map)
        if found is None:
            rescued = self.tracked(tracker.map, frame) if outcome.success else self.ended()
            if rescued:
                emit(frame, ev.RescueEnd, success=outcome.success, frames=rescued)
            return outcome
        if first:
            emit(frame, ev.RescueStart, reason=outcome.reason, inliers=outcome.inliers)
        return tracker.take_pose(frame, found.T_cam_map, found.keyframe, found.velocity)

    def keep(self, map_: Map, frame: Frame, image: np.ndarray) -> None:
        """Keep the image (H, W) uint8 of a frame that becomes a keyframe."""
        self._newest.appendleft((map_, frame, image.copy()))

    def tracked(self, map_: Map, frame: Frame) -> int:
        """Take note of a frame that features tracked; the number of frames rescued before it."""
        if map_ is not self._map:
            self._map = map_
            self._path.clear()
        rescued, self.frames, self._tracked_s = self.frames, 0, frame.features.stamp_s
        self._path.append(frame)
        return rescued

    def ended(self) -> int:
        """Give up, as no frame is placed any more or another map is tracked: the number rescued so far."""
        rescued, self.frames = self.frames, 0
        self._path.clear()
        return rescued

    def attempt(self, frame: Frame, image: np.ndarray, camera: PinholeCamera, map_: Map) -> Rescued | None:
        """Place a frame that features do not track by the newest keyframes of the map.

        Args:
            frame: the frame, without a pose.
            image: (H, W) uint8, its image.
            camera: of the image, as refined by now.
            map_: the current map.

        Returns:
            Its pose; None if no keyframe looks like it.
        """
        late = frame.features.stamp_s - self._tracked_s > self.config.max_s
        if late or self._rectifier.is_too_small or not self._path or map_ is not self._map:
            return None
        if camera != self._camera:
            self._camera, self._rectifier = camera, Rectifier(camera)
        target, velocity = self._rectifier.pyramid(image), self._velocity(map_)
        predicted = velocity @ _pose(self._path[-1], map_)
        for of_map, keyframe, its_image in self._newest:
            row = keyframe.reference_keyframe
            # Until mapping has taken it in, a frame is no keyframe yet.
            is_in_map = of_map is map_ and np.array_equal(keyframe.T_cam_reference, np.eye(4))
            if is_in_map and not map_.arrays.kf_bad[row]:
                T_cam_map = self._placed_by(map_, row, its_image, target, predicted, velocity)
                if T_cam_map is not None:
                    self.frames += 1
                    self._path.append(frame)
                    return Rescued(T_cam_map, row, velocity)
        return None

    def _velocity(self, map_: Map) -> np.ndarray:
        """(4, 4) motion per frame over the last frames."""
        first, last = self._path[0], self._path[-1]
        frames = last.features.index - first.features.index
        moved = _pose(last, map_) @ np.linalg.inv(_pose(first, map_))
        return share_of_motion(moved, 1 / frames) if frames else np.eye(4)

    def _placed_by(
        self,
        map_: Map,
        row: int,
        image: np.ndarray,
        target: ImagePyramid,
        predicted: np.ndarray,
        velocity: np.ndarray,
    ) -> np.ndarray | None:
        """(4, 4) pose of a frame near a predicted one by a keyframe; None if they do not look alike."""
        source, config, intrinsics = self._rectifier.pyramid(image), self.config, self._rectifier.intrinsics
        xy, xyz = self._pixels(map_, row, source)
        if len(xy) < config.min_points:
            return None
        view = Reference(source, intrinsics, xy, 1 / xyz[:, 2], config.placement.alignment)
        T_ref_map = map_.T_cam_map(row)
        guesses = [predicted @ np.linalg.inv(T_ref_map), np.eye(4)]
        placed = place(view, xyz, source, target, self._rectifier, velocity, guesses, config.placement)
        return None if placed.found is None else np.ascontiguousarray(placed.found.T_target_ref @ T_ref_map)

    def _pixels(self, map_: Map, row: int, source: ImagePyramid) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) selected pixels of a keyframe near its map points, and (n, 3) their points in its camera."""
        selected = select(source, self.config.selection)
        keyframe = Frame(map_.features(row))
        pixels = TrackedFrame(keyframe, selected.xy.astype(float), np.ones(len(selected.xy)))
        seen = map_.observed_points(row)
        rows = np.flatnonzero(seen >= 0)
        take_depth_from_points(
            pixels, map_.arrays.pt_xyz[seen[rows]], keyframe.features.xy[rows], map_.T_cam_map(row),
            map_.view, self.config.depth_radius_px,
        )  # fmt: skip
        return pixels.xy[pixels.known], pixels.xyz_cam[pixels.known]


def _pose(frame: Frame, map_: Map) -> np.ndarray:
    """(4, 4) T_cam_map of a tracked frame as the map is now."""
    return frame.T_cam_reference @ map_.T_cam_map(frame.reference_keyframe)
