"""The steps that systems are made of: frames in, one map at a time."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.frame_input import check_frame
from dslab.slam.core.geometry import view_geometry
from dslab.slam.core.results import TrackingResult
from dslab.slam.core.seeds import rng_for
from dslab.slam.core.timing import StageTimer
from dslab.slam.features.finder import FeatureFinder
from dslab.slam.features.remembered import Remembered
from dslab.slam.handover import Handover, take_refinement
from dslab.slam.initialization.initializer import Initializer, InitialMap, frames_between
from dslab.slam.initialization.second_motion import SecondMotion
from dslab.slam.map.withdrawal import cull_since
from dslab.slam.map_store import Loss, MapStore
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.mapping.self_calibration import SelfCalibration
from dslab.slam.place_search import PlaceSearch
from dslab.slam.runtime.backend import Backend, Calibrated, Change, ExecutionMode, KeyframeTask, MapChange
from dslab.slam.tracking.local_map import note_twist, note_twists
from dslab.slam.tracking.probation import Probation
from dslab.slam.tracking.rescue import Rescue
from dslab.slam.tracking.tracker import Tracker, TrackingOutcome

_SEEKING = TrackingState.NOT_INITIALIZED


class SlamEngine:
    """Features, initialization, tracking, mapping, loop closing, relocalization, each as one step.

    It decides nothing about what follows a loss of tracking: the systems do.

    Args:
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings.
        mode: lockstep or threaded.

    Attributes:
        events: all events so far.
        state: of tracking.
        store: the maps.
        search: for the place of a lost camera.
        backend: mapping and loop closing.
        timer: of the tracking thread.
        frames: number of frames processed so far.
        handover: of what mapping and loop closing have done.
        second_motion: the other motion that the current map's start may have had, None once it is ruled out.
        remembered: what recovery threads have found in images; None unless it is kept.
    """

    def __init__(self, camera: PinholeCamera, seed: int, config: SlamConfig, mode: ExecutionMode) -> None:
        self.camera = camera
        self.seed = seed
        self.config = config
        self.events: list[ev.Event] = []
        self.view = view_geometry(camera, config.orb.n_levels, config.orb.scale_factor, config.orb.noise_px)
        self.state = _SEEKING
        self.timer = StageTimer()
        self.store = MapStore(config)
        self.handover = Handover(self.store, self.emit_at)
        self.frames = 0
        self._newest: Frame | None = None
        self.remembered: Remembered | None = None
        self._self_calibration = SelfCalibration(config.self_calibration)
        self.backend = Backend(self._apply, mode, self._self_calibration)
        self.search = PlaceSearch(self.store, seed, config, self.timer, self.backend.lock, self.emit_at)
        self._finder = FeatureFinder(camera, config.orb, config.initial_features)
        self._initializer = Initializer(camera, self.view, config.initialization)
        self._tracker: Tracker | None = None
        self._mapper: LocalMapper | None = None
        self.second_motion: SecondMotion | None = None
        self._rescue = Rescue(camera, config.rescue) if config.rescue.max_s > 0 else None
        self._image = np.empty((0, 0), np.uint8)  # of the newest frame
        self._last_stamp_s = -np.inf

    @property
    def newest(self) -> Frame:
        """The newest frame."""
        if self._newest is None:
            raise RuntimeError("there is no frame yet")
        return self._newest

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

    # -- a frame -----------------------------------------------------------------------------------------

    def receive(self, image: np.ndarray, stamp_s: float) -> Frame:
        """Begin a frame: find features, apply what mapping has handed over since the last one.

        Raises:
            ValueError: wrong size or type of image, time not increasing.
        """
        self.timer.begin()
        check_frame(image, stamp_s, self.camera, self.frames, self._last_stamp_s)
        self._last_stamp_s = stamp_s
        # A frame that is not offered for a start needs no more features than others.
        dense = self.state is _SEEKING and not self.search.undecided
        self._image = image
        self._newest = frame = Frame(self._features(self.frames, stamp_s, dense))
        self.frames += 1
        self.backend.collect()
        return frame

    def again(self, frame: Frame) -> Frame:
        """The newest frame once more, without pose and matches, with as many features as tracked frames have.

        Those by which a map is sought are many times more. They would show more of a place than is expected
        of a frame, and more of a wrong one.
        """
        features = frame.features
        if self.state is _SEEKING and not self.search.undecided:
            features = self._features(features.index, features.stamp_s, dense=False)
        return Frame(features)

    def remember_features(self, images: int) -> None:
        """Keep the features of so many images, for copies that see the same ones."""
        self.remembered = Remembered(2 * images)
        self._finder.remember(images)

    def _features(self, index: int, stamp_s: float, dense: bool) -> FrameFeatures:
        with self.timer("extract"):
            features = self._finder.find(self._image, dense)
            twist = self.tracker.twist if self.state is TrackingState.TRACKING else None
            return FrameFeatures.build(index, stamp_s, features, self.camera, self.view, twist)

    def initialize(self, frame: Frame) -> tuple[TrackingOutcome, InitialMap | None]:
        """Try to initialize a map."""
        rng = rng_for(self.seed, "initialization", frame.features.index)
        with self.timer("initialize"):
            initial, reason, matches = self._initializer.offer(
                frame, self.store.current_id, rng, self.config.mapping
            )
            if initial is not None:
                self._start_map(initial)
        if initial is None:
            return TrackingOutcome(False, 0, matches, reason), None
        frame.point, frame.T_cam_map = initial.second.point, initial.second.T_cam_map
        frame.reference_keyframe, frame.T_cam_reference = 1, np.eye(4)
        return TrackingOutcome(True, initial.points, matches), initial

    def track(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        """Track the frame in the current map; the outcome, and True if it has become a keyframe."""
        with self.backend.lock:
            before, twist = self.tracker.last, self.tracker.twist
            outcome = self.tracker.track(frame)
            if outcome.success and before is not None:
                note_twist(self.tracker.map, before, (twist + self.tracker.twist) / 2)
            doubt = self.tracker.doubt
            if outcome.success and doubt.reason:
                outcome = TrackingOutcome(False, outcome.inliers, outcome.matches, doubt.reason)
            if outcome.success:
                self._judge_start(frame)
            idle = self.backend.idle
            is_keyframe = outcome.success and self.tracker.wants_keyframe(frame, outcome.inliers, idle)
            if self._rescue is not None:
                outcome = self._rescue.go_on(
                    frame, self._image, outcome, self.tracker, self.camera, self.timer, self.emit
                )
        if is_keyframe:
            self._map(frame)
        return outcome, is_keyframe

    def relocalize(
        self,
        frame: Frame,
        map_ids: Sequence[int],
        leave: Callable[[Frame], None] | None = None,
        begin: bool = True,
    ) -> TrackingOutcome:
        """Search maps, in their order, for a frame; success once it is confirmed: tracking goes on there.

        Args:
            frame: without a pose, and no other frame of the tracker.
            map_ids: of the maps.
            leave: leaves the map that is tracked meanwhile, if one is.
            begin: begin a probation if none is under way.
        """
        outcome, confirmed = self.search.offer(frame, map_ids, begin)
        if confirmed is None:
            return outcome
        if leave is not None:
            tracked = self.store.current_id
            self.backend.drain()
            if self.store.current_id != tracked or confirmed.map_id not in self.store:  # fused meanwhile
                self.search.reject(confirmed, frame, "maps_are_joined")
                return TrackingOutcome(False, outcome.inliers, outcome.matches, "maps_are_joined")
            leave(frame)
        self._resume(confirmed, frame, outcome)
        return outcome

    def declare_breakage(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Declare the current map broken, and take back what was said and learned since it is doubted."""
        self.backend.drain()
        self.emit(frame, ev.Breakage, reason=outcome.reason, inliers=outcome.inliers)
        self.tracker.doubt.lose()
        self._withdraw_doubted(frame)

    def lose(self, frame: Frame) -> None:
        """Put down that tracking is lost in the current map, to be found again there."""
        doubt = self.tracker.doubt
        self.store.note_loss(self.store.current_id, Loss(frame.features, doubt if doubt.reason else None))
        self.search.start()

    @property
    def is_begun_wrong(self) -> bool:
        """True if the frames that followed show that the current map was begun from the wrong motion."""
        return self.second_motion is not None and self.second_motion.verdict == "second"

    def drop_wrong_map(self, frame: Frame, outcome: TrackingOutcome) -> TrackingOutcome:
        """Drop the current map, begun from the wrong motion, with all its poses; the outcome then."""
        self.backend.drain()
        if not self.is_begun_wrong:  # joined meanwhile
            return outcome
        self.drop_map(frame, "second_motion")
        return TrackingOutcome(False, outcome.inliers, outcome.matches, "second_motion")

    @property
    def is_young(self) -> bool:
        """True if the current map has too few keyframes to be kept."""
        return len(self.store.current.keyframes()) <= self.config.min_map_keyframes

    def drop_map(self, frame: Frame, reason: str) -> None:
        """Drop the current map; a new one is sought."""
        self.emit(frame, ev.MapDropped, reason=reason, keyframes=len(self.store.current.keyframes()))
        self.store.poses.drop(self.store.current_id)
        self.store.forget(self.store.current_id)
        self.seek_new_map()

    def seek_new_map(self) -> None:
        """Seek a new map from the next frame on."""
        self.store.next_map()
        self.second_motion = None
        self._initializer.reset()
        self.state = _SEEKING

    def record(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Keep the pose of a tracked frame."""
        if outcome.success:
            self.store.poses.add(self.store.current_id, frame)

    def result(self, frame: Frame, outcome: TrackingOutcome, is_keyframe: bool) -> TrackingResult:
        """End a frame: its result, with the times of its steps."""
        done, (ms, cpu_ms) = self.handover, self.timer.read()
        result = TrackingResult(
            frame=frame.features.index,
            stamp_s=frame.features.stamp_s,
            state=self.state,
            T_map_cam=np.linalg.inv(frame.T_cam_map) if outcome.success else None,
            map_id=self.store.current_id,
            inliers=outcome.inliers,
            matches=outcome.matches,
            reason=outcome.reason,
            is_keyframe=is_keyframe,
            keypoints_px=frame.features.xy_image,
            inlier_mask=(frame.point >= 0) & outcome.success,
            cpu_ms=cpu_ms,
            ms=ms,
            mapping_cpu_ms=done.mapping_cpu_ms,
            loop_cpu_ms=done.loop_cpu_ms,
            relative=frame.relative if outcome.success else None,
        )
        done.mapping_cpu_ms = done.loop_cpu_ms = 0.0
        return result

    # -- events ------------------------------------------------------------------------------------------

    def emit(self, frame: Frame, kind: type[ev.Event], **fields) -> None:
        """Add an event of the current map."""
        self.emit_at(frame, kind, self.store.current_id, **fields)

    def emit_now(self, kind: type[ev.Event], map_id: int, **fields) -> None:
        """Add an event of a map at the newest frame."""
        self.emit_at(self.newest, kind, map_id, **fields)

    def emit_at(self, frame: Frame, kind: type[ev.Event], map_id: int, **fields) -> None:
        """Add an event of a map."""
        features = frame.features
        self.events.append(kind(frame=features.index, stamp_s=features.stamp_s, map_id=map_id, **fields))

    # -- maps --------------------------------------------------------------------------------------------

    def enter(self, map_id: int) -> None:
        """Make a map the current one, for tracking and mapping."""
        self.store.current_id = map_id
        if self._rescue is not None:
            self._rescue.ended()
        m = self.store.current
        self._mapper = LocalMapper(m, self.config.mapping, self.backend.lock)
        motion = None if self._tracker is None else self._tracker.motion
        self._tracker = Tracker(m, self.config.tracking, self.timer, motion)
        self.second_motion = None

    def _start_map(self, initial: InitialMap) -> None:
        store = self.store
        store.add(initial.map)
        self.enter(initial.map.map_id)
        self.second_motion = initial.second_motion
        self.tracker.start(initial.second, 1)
        between = frames_between(initial, self.config.tracking)
        for frame in (initial.first, *between):
            store.poses.add(store.current_id, frame)
        note_twists(self.store.current, [initial.second, *between, initial.first])
        self.state = TrackingState.TRACKING
        self.emit(initial.second, ev.Initialized, points=initial.points, model=initial.model)

    def _judge_start(self, frame: Frame) -> None:
        """Judge the motion that the current map was begun from by a tracked frame, while there is another."""
        if self.second_motion is not None:
            with self.timer("second_motion"):
                self.second_motion.note(frame)
            if self.second_motion.verdict == "first":
                self.second_motion = None

    def _map(self, frame: Frame) -> None:
        """Run local mapping on a new keyframe, then loop closing and, when it is due, self-calibration."""
        self.tracker.keyframe_requested(frame)
        m = self.store.current
        if self._rescue is not None:
            self._rescue.keep(m, frame, self._image)
        rng = rng_for(self.seed, "loop", frame.features.index)
        due = self._may_refine_camera() and self._self_calibration.is_due(m)
        camera = self.camera if due else None
        loops = self.store.places(m.map_id).loops
        with self.timer.apart():
            self.backend.submit(KeyframeTask(frame, self.mapper, loops, rng, camera))

    def _resume(self, probation: Probation, frame: Frame, outcome: TrackingOutcome) -> None:
        """Go on where a relocalization was confirmed."""
        store = self.store
        if probation.map_id != store.current_id:
            self.enter(probation.map_id)
        self._tracker = probation.tracker
        for tracked in probation.frames:
            store.poses.add(probation.map_id, tracked)
        self._initializer.reset()
        self.state = TrackingState.TRACKING
        self.search.report(probation, frame, outcome)

    def _withdraw_doubted(self, frame: Frame) -> None:
        """Take back what was said and learned since the map is doubted, if it is."""
        doubt, m = self.tracker.doubt, self.store.current
        if not doubt.reason:
            return
        first_frame = doubt.first_frame
        poses = self.store.poses.take_back(m.map_id, first_frame)
        culled = cull_since(m, first_frame)
        if culled:  # what stays has been adjusted to what goes
            self.mapper.adjust(m.live(culled[-1]))
        first, last = (poses[0], poses[-1]) if poses else (first_frame, first_frame)
        self.emit(
            frame, ev.PosesWithdrawn,
            first_frame=first, last_frame=last, frames=len(poses), keyframes=len(culled), reason=doubt.reason,
        )  # fmt: skip

    # -- what mapping and loop closing hand over ---------------------------------------------------------

    def _apply(self, change: Change) -> None:
        """Take over a change made by mapping or loop closing, or by what runs beside them."""
        if isinstance(change, MapChange):
            if change.is_still_valid():
                with self.timer(change.stage) if change.stage else nullcontext():
                    change.commit()
        elif isinstance(change, Calibrated):
            self.handover.mapping_cpu_ms += change.cpu_ms
            if self.state is TrackingState.TRACKING and self._may_refine_camera():  # not broken meanwhile
                refined = take_refinement(change, self._frames_in_work(), self.emit_at)
                self.camera = refined or self.camera
        else:
            self.handover.take(change, self.tracker)

    def _frames_in_work(self) -> list[Frame]:
        """Frames whose features are still to be used."""
        frames = [self.newest, self.tracker.last, self.backend.newest and self.backend.newest.frame]
        return list({id(frame): frame for frame in frames if frame is not None}.values())

    def _may_refine_camera(self) -> bool:
        """Return True while there is one map, its start beyond doubt, in which tracking was never lost."""
        return self.store.is_one_unbroken and self.second_motion is None
