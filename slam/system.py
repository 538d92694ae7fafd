"""The monocular SLAM system: reads as the steps of the method."""

from dataclasses import asdict, dataclass, field, replace
from numbers import Real

import numpy as np

from slam import events as ev
from slam.camera import PinholeCamera
from slam.events import TrackingState
from slam.frame import Frame, FrameFeatures
from slam.geometry import view_geometry
from slam.initialization import InitializationConfig, Initializer, InitialMap
from slam.local_mapping import LocalMapper, LocalMappingConfig
from slam.map import Map
from slam.orb import OrbConfig, OrbExtractor
from slam.results import MapTrajectory, TrackingResult
from slam.seeds import rng_for
from slam.timing import StageTimer
from slam.tracking import Tracker, TrackingConfig, TrackingOutcome
from slam.trajectory import FramePoses, keyframe_trajectory


@dataclass(frozen=True)
class SlamConfig:
    """Settings of the base system, one group per component.

    Attributes:
        min_map_keyframes: a map that breaks with no more keyframes is dropped instead of kept.
    """

    orb: OrbConfig = field(default_factory=OrbConfig)
    initialization: InitializationConfig = field(default_factory=InitializationConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    mapping: LocalMappingConfig = field(default_factory=LocalMappingConfig)
    min_map_keyframes: int = 5


class MonocularSlam:
    """ORB-SLAM's monocular method in lockstep: tracking and mapping alternate at frame boundaries.

    Args:
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings.

    Attributes:
        events: everything that happened so far.
    """

    def __init__(self, camera: PinholeCamera, seed: int = 0, config: SlamConfig | None = None) -> None:
        self.camera = camera
        self.seed = seed
        self.config = config or SlamConfig()
        self.events: list[ev.Event] = []
        self.view = view_geometry(camera, self.config.orb.n_levels, self.config.orb.scale_factor)
        self.state = TrackingState.NOT_INITIALIZED
        self.timer = StageTimer()
        self._extractor = OrbExtractor(camera.width_px, camera.height_px, self.config.orb)
        self._initializer = Initializer(camera, self.view, self.config.initialization)
        self._tracker: Tracker | None = None
        self._mapper: LocalMapper | None = None
        self._maps: dict[int, Map] = {}
        self._poses = FramePoses()
        self._map_id = 0
        self._frames = 0
        self._last_stamp_s = -np.inf

    # -- the method --------------------------------------------------------------------------------------

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Take one frame.

        Args:
            image: (H, W) uint8 grey image of the camera's size.
            stamp_s: its time, later than the last one's.

        Returns:
            What became of it.

        Raises:
            ValueError: on misuse: wrong size or type of image, time not increasing. The content of an
                image never raises.
        """
        self._check_input(image, stamp_s)
        frame = self._extract_features(image, stamp_s)
        mapping_cpu_ms = 0.0
        is_keyframe = False
        if self.state is TrackingState.NOT_INITIALIZED:
            outcome = self._initialize(frame)
            is_keyframe = outcome.success
        elif self.state is TrackingState.TRACKING:
            outcome = self._track(frame)
            if not outcome.success:
                self._break(frame, outcome)
            elif self.tracker.wants_keyframe(frame, outcome.inliers):
                is_keyframe = True
                mapping_cpu_ms = self._map(frame)
        else:
            outcome = TrackingOutcome(False, 0, 0, "lost")
        self._record(frame, outcome)
        self._after_frame(frame, outcome)
        return self._result(frame, outcome, is_keyframe, mapping_cpu_ms)

    def finish(self) -> None:
        """End of input: nothing is pending in lockstep."""

    def _extract_features(self, image: np.ndarray, stamp_s: float) -> Frame:
        with self.timer("extract"):
            features = self._extractor.extract(image)
            frame = Frame(FrameFeatures.build(self._frames, stamp_s, features, self.camera, self.view))
        self._frames += 1
        return frame

    def _initialize(self, frame: Frame) -> TrackingOutcome:
        rng = rng_for(self.seed, "initialization", frame.features.index)
        with self.timer("initialize"):
            initial, reason, matches = self._initializer.offer(frame, self._map_id, rng, self.config.mapping)
        if initial is None:
            return TrackingOutcome(False, 0, matches, reason)
        self._start_map(initial)
        frame.point = initial.second.point
        frame.T_cam_map = initial.second.T_cam_map
        frame.reference_keyframe, frame.T_cam_reference = 1, np.eye(4)
        return TrackingOutcome(True, initial.points, matches)

    def _start_map(self, initial: InitialMap) -> None:
        self._maps[self._map_id] = initial.map
        self._mapper = LocalMapper(initial.map, self.config.mapping)
        self._tracker = Tracker(initial.map, self.config.tracking, self.timer)
        self._tracker.start(initial.second, 1)
        self._poses.add(self._map_id, initial.first)
        self.state = TrackingState.TRACKING
        self._emit(initial.second, ev.Initialized, points=initial.points, model=initial.model)

    def _track(self, frame: Frame) -> TrackingOutcome:
        return self.tracker.track(frame)

    def _map(self, frame: Frame) -> float:
        """Local mapping on a new keyframe; CPU milliseconds spent."""
        mapping = StageTimer()
        with mapping("mapping"):
            keyframe = self.mapper.insert(frame)
            self.tracker.keyframe_made(frame, keyframe)
        return mapping.cpu_ms["mapping"]

    def _break(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Tracking is lost: a map too young is dropped and another sought, any other is kept as it is."""
        self._emit(frame, ev.Breakage, reason=outcome.reason, inliers=outcome.inliers)
        if self._drop_if_young(frame):
            return
        self.state = TrackingState.LOST

    def _drop_if_young(self, frame: Frame) -> bool:
        if len(self.current_map.keyframes()) > self.config.min_map_keyframes:
            return False
        self._drop(frame, "too_few_keyframes")
        return True

    def _drop(self, frame: Frame, reason: str) -> None:
        """Discard the current map and seek another."""
        self._emit(frame, ev.MapDropped, reason=reason, keyframes=len(self.current_map.keyframes()))
        self._poses.drop(self._map_id)
        del self._maps[self._map_id]
        self._seek_new_map()

    def _seek_new_map(self) -> None:
        self._map_id += 1
        self._initializer.reset()
        self.state = TrackingState.NOT_INITIALIZED

    def _after_frame(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Hook of systems built on this one."""

    # -- what the outside sees ---------------------------------------------------------------------------

    @property
    def settings(self) -> dict:
        """Every setting in force, nested by component, to be saved with the results."""
        return asdict(self.config)

    @property
    def tracker(self) -> Tracker:
        """The tracker of the current map."""
        if self._tracker is None:
            raise RuntimeError("there is no map yet")
        return self._tracker

    @property
    def mapper(self) -> LocalMapper:
        """The mapper of the current map."""
        if self._mapper is None:
            raise RuntimeError("there is no map yet")
        return self._mapper

    @property
    def current_map(self) -> Map:
        """The map that tracking works in."""
        return self._maps[self._map_id]

    @property
    def current_map_id(self) -> int:
        """Number of the current map, or of the one being sought."""
        return self._map_id

    def maps(self) -> list[int]:
        """Numbers of the maps that exist, the one with most tracked frames first."""
        return sorted(self._maps, key=lambda k: (-self._poses.count(k), k))

    def map(self, map_id: int) -> Map:
        """A map by its number."""
        return self._maps[map_id]

    def map_points(self, map_id: int) -> np.ndarray:
        """(n, 3) float64 points of a map, in its own frame."""
        m = self._maps[map_id]
        return m.arrays.pt_xyz[m.points()].copy()

    def trajectories(self) -> list[MapTrajectory]:
        """Poses of the tracked frames as the maps stand now, the map with most frames first."""
        return [self._poses.trajectory(k, self._maps[k]) for k in self.maps()]

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        """Poses of the keyframes, in the order of :meth:`trajectories`."""
        return [keyframe_trajectory(self._maps[k]) for k in self.maps()]

    # -- bookkeeping -------------------------------------------------------------------------------------

    def _check_input(self, image: np.ndarray, stamp_s: float) -> None:
        shape = (self.camera.height_px, self.camera.width_px)
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape != shape:
            got = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            raise ValueError(f"frame {self._frames}: expected a uint8 image of shape {shape}, got {got}")
        is_time = isinstance(stamp_s, Real) and np.isfinite(stamp_s)
        if not is_time or not stamp_s > self._last_stamp_s:
            raise ValueError(
                f"frame {self._frames}: time {stamp_s} s is not after the last one, {self._last_stamp_s} s"
            )
        self._last_stamp_s = stamp_s

    def _record(self, frame: Frame, outcome: TrackingOutcome) -> None:
        if outcome.success:
            self._poses.add(self._map_id, frame)

    def _result(
        self, frame: Frame, outcome: TrackingOutcome, is_keyframe: bool, mapping_cpu_ms: float
    ) -> TrackingResult:
        ms, cpu_ms = self.timer.read()
        T_map_cam = np.linalg.inv(frame.T_cam_map) if outcome.success else None
        return TrackingResult(
            frame=frame.features.index,
            stamp_s=frame.features.stamp_s,
            state=self.state,
            T_map_cam=T_map_cam,
            map_id=self._map_id,
            inliers=outcome.inliers,
            matches=outcome.matches,
            reason=outcome.reason,
            is_keyframe=is_keyframe,
            keypoints_px=frame.features.xy_image,
            inlier_mask=(frame.point >= 0) & outcome.success,
            cpu_ms=cpu_ms,
            ms=ms,
            mapping_cpu_ms=mapping_cpu_ms,
        )

    def _emit(self, frame: Frame, kind: type[ev.Event], **fields) -> None:
        event = kind(
            frame=frame.features.index, stamp_s=frame.features.stamp_s, map_id=self._map_id, **fields
        )
        self.events.append(event)


def build_system(
    kind: str, camera: PinholeCamera, seed: int = 0, config: SlamConfig | None = None
) -> MonocularSlam:
    """A system by name.

    Args:
        kind: ``base`` or ``dual``.
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings; the published defaults, scaled to the image size, where None.

    Raises:
        ValueError: on an unknown kind.
    """
    from slam.dual.supervisor import DualSlam

    systems = {"base": MonocularSlam, "dual": DualSlam}
    if kind not in systems:
        raise ValueError(f"unknown system {kind!r}: one of {', '.join(systems)}")
    return systems[kind](camera, seed, config or default_config(camera))


def default_config(camera: PinholeCamera) -> SlamConfig:
    """Published settings: 1,000 features up to 640x480, 2,000 for wider images such as KITTI's."""
    wide = camera.width_px * camera.height_px > 1.2 * 640 * 480
    return replace(SlamConfig(), orb=OrbConfig(n_features=2000 if wide else 1000))
