"""Monocular SLAM system, written as the steps of the method."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from numbers import Real
from typing import Self

import numpy as np

from slam.config import SlamConfig
from slam.core import events as ev
from slam.core.camera import PinholeCamera
from slam.core.events import TrackingState
from slam.core.frame import Frame, FrameFeatures
from slam.core.geometry import view_geometry
from slam.core.results import MapTrajectory, TrackingResult
from slam.core.seeds import rng_for
from slam.core.snapshot import Snapshot
from slam.core.timing import StageTimer
from slam.features.orb import OrbExtractor
from slam.initialization.initializer import Initializer, InitialMap, frames_between
from slam.map.adjustment import apply_adjustment
from slam.map.map import Map
from slam.map.relation import loop_relation, relocalization_relation
from slam.map.trajectory import FramePoses, keyframe_trajectory
from slam.map.withdrawal import cull_since
from slam.map_places import Places
from slam.mapping.local_mapping import LocalMapper
from slam.mapping.self_calibration import SelfCalibration
from slam.runtime.backend import (
    Backend,
    Calibrated,
    Change,
    Corrected,
    ExecutionMode,
    KeyframeTask,
    Mapped,
    Refused,
    Searched,
)
from slam.tracking.doubt import Doubt
from slam.tracking.probation import Probation, Verdict
from slam.tracking.reach import Reach
from slam.tracking.tracker import Tracker, TrackingOutcome

_PX_PER_FEATURE = 45.0  # an image has room for at most one feature in this many pixels


class MonocularSlam:
    """ORB-SLAM's monocular method: tracking, local mapping, relocalization, loop closing.

    Args:
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings.
        mode: ``lockstep``: results do not depend on the load of the machine, bit for bit; or ``threaded``:
            mapping and loop closing run beside tracking. A threaded system must be ended by :meth:`finish`.

    Attributes:
        events: all events so far.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int = 0,
        config: SlamConfig | None = None,
        mode: ExecutionMode = ExecutionMode.LOCKSTEP,
    ) -> None:
        self.camera = camera
        self.seed = seed
        self.config = config or SlamConfig()
        self.events: list[ev.Event] = []
        self.view = view_geometry(camera, self.config.orb.n_levels, self.config.orb.scale_factor)
        self.state = TrackingState.NOT_INITIALIZED
        self.timer = StageTimer()
        width, height, orb = camera.width_px, camera.height_px, self.config.orb
        self._extractor = OrbExtractor(width, height, orb)
        wanted = min(self.config.initial_features * orb.n_features, width * height / _PX_PER_FEATURE)
        more = replace(orb, n_features=max(orb.n_features, round(wanted)))
        self._initial_extractor = OrbExtractor(width, height, more)
        self._initializer = Initializer(camera, self.view, self.config.initialization)
        self._tracker: Tracker | None = None
        self._mapper: LocalMapper | None = None
        self._self_calibration = SelfCalibration(self.config.self_calibration)
        self._maps: dict[int, Map] = {}
        self._known_places: dict[int, Places] = {}
        self._broken_at: dict[int, FrameFeatures] = {}
        self._probation: Probation | None = None
        self._doubts: dict[int, Doubt] = {}  # those for which maps were lost
        self._doubted: tuple[tuple[float, str], ...] = ()  # frames of withdrawn probations since the loss
        self._reaches: dict[int, Reach | None] = {}
        self._backend = Backend(self._apply, mode, self._self_calibration)
        self._mapping_cpu_ms = self._loop_cpu_ms = 0.0
        self._poses = FramePoses()
        self._map_id = self._newest_map_id = 0
        self._frames = 0
        self._newest: Frame | None = None
        self._last_stamp_s = -np.inf

    # -- the method --------------------------------------------------------------------------------------

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Process one frame.

        Args:
            image: (H, W) uint8 grey image of the camera's size.
            stamp_s: its time, later than the last one's.

        Returns:
            The outcome of the frame.

        Raises:
            ValueError: on misuse: wrong size or type of image, time not increasing. The content of an
                image never raises.
        """
        self.timer.begin()
        self._check_input(image, stamp_s)
        self._backend.collect()
        frame = self._newest = self._extract_features(image, stamp_s)
        is_keyframe = False
        if self.state is TrackingState.NOT_INITIALIZED:
            outcome, is_keyframe = self._initialize(frame)
        elif self.state is TrackingState.TRACKING:
            outcome, is_keyframe = self._track(frame)
            if is_keyframe:
                self._map(frame)
            elif not outcome.success:
                self._backend.drain()
                self._break(frame, outcome)
        else:
            outcome = self._relocalize(frame)
        self._record(frame, outcome)
        self._after_frame(frame, outcome, image)
        return self._result(frame, outcome, is_keyframe)

    def finish(self) -> None:
        """End the input: complete pending work and stop the threads of threaded mode."""
        self._backend.close()

    def _extract_features(self, image: np.ndarray, stamp_s: float) -> Frame:
        with self.timer("extract"):
            seeking = self.state is TrackingState.NOT_INITIALIZED
            features = (self._initial_extractor if seeking else self._extractor).extract(image)
            frame = Frame(FrameFeatures.build(self._frames, stamp_s, features, self.camera, self.view))
        self._frames += 1
        return frame

    def _initialize(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        """Try to initialize a map; the outcome, and True if the frame is a keyframe."""
        rng = rng_for(self.seed, "initialization", frame.features.index)
        with self.timer("initialize"):
            initial, reason, matches = self._initializer.offer(frame, self._map_id, rng, self.config.mapping)
            if initial is not None:
                self._start_map(initial)
        if initial is None:
            return TrackingOutcome(False, 0, matches, reason), False
        frame.point = initial.second.point
        frame.T_cam_map = initial.second.T_cam_map
        frame.reference_keyframe, frame.T_cam_reference = 1, np.eye(4)
        return TrackingOutcome(True, initial.points, matches), True

    def _start_map(self, initial: InitialMap) -> None:
        self._maps[self._map_id] = initial.map
        self._enter(self._map_id)
        self.tracker.start(initial.second, 1)
        self._poses.add(self._map_id, initial.first)
        for frame in frames_between(initial, self.config.tracking):
            self._poses.add(self._map_id, frame)
        self.state = TrackingState.TRACKING
        self._emit(initial.second, ev.Initialized, points=initial.points, model=initial.model)

    def _enter(self, map_id: int) -> None:
        """Make a map the current one, for tracking and mapping."""
        self._map_id = map_id
        self._mapper = LocalMapper(self._maps[map_id], self.config.mapping, self._backend.lock)
        self._tracker = Tracker(self._maps[map_id], self.config.tracking, self.timer)

    def _track(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        """Track the frame; the outcome, and True if it is to become a keyframe."""
        with self._backend.lock:
            outcome = self.tracker.track(frame)
            doubt = self.tracker.doubt
            if outcome.success and doubt.reason:
                outcome = TrackingOutcome(False, outcome.inliers, outcome.matches, doubt.reason)
            wanted = outcome.success and self.tracker.wants_keyframe(frame, outcome.inliers)
        return outcome, wanted and self._backend.idle

    def _map(self, frame: Frame) -> None:
        """Run local mapping on a new keyframe, then loop closing."""
        self.tracker.keyframe_requested(frame)
        loops = self._places(self._map_id).loops
        rng = rng_for(self.seed, "loop", frame.features.index)
        due = self._may_refine_camera() and self._self_calibration.is_due(self.current_map)
        residual = self.camera.residual if due else None
        with self.timer.apart():
            self._backend.submit(KeyframeTask(frame, self.mapper, loops, rng, residual))

    def _may_refine_camera(self) -> bool:
        """Return True while all poses are in one map."""
        return len(self._maps) == 1

    def _camera_refined(self) -> None:
        """Do nothing; a hook for derived systems that keep features."""

    def _apply(self, change: Change) -> None:
        """Apply a change made by mapping or loop closing."""
        if isinstance(change, Mapped):
            self._mapping_cpu_ms += change.cpu_ms
            if self.tracker.last is change.frame:
                self.tracker.keyframe_made(change.frame, change.keyframe)
        elif isinstance(change, Searched):
            self._loop_cpu_ms += change.cpu_ms
        elif isinstance(change, Corrected):
            self._apply_correction(change)
        elif isinstance(change, Refused):
            self._report_refusal(change)
        elif isinstance(change, Calibrated):
            self._apply_refinement(change)
        else:
            self._loop_cpu_ms += change.cpu_ms
            m = change.task.mapper.map
            apply_adjustment(m, change.adjustment)
            self._emit_at(
                change.task.frame,
                ev.MapAdjusted,
                m.map_id,
                keyframes=len(change.adjustment.keyframes),
                points=len(change.adjustment.points),
                cpu_ms=change.cpu_ms,
            )

    def _apply_correction(self, change: Corrected) -> None:
        """Apply a loop closure to the map, its frames and the tracker."""
        m, loop, frame = change.task.mapper.map, change.loop, change.task.frame
        self._loop_cpu_ms += change.cpu_ms
        relation = loop_relation(m, loop.keyframe, loop.loop_keyframe, loop.S_cam_map)
        m.adopt(change.corrected_map)
        self._poses.rescale(m.map_id, change.factor)
        self.tracker.corrected(change.factor)
        self._emit_at(
            frame,
            ev.LoopClosed,
            m.map_id,
            keyframe=m.frame_index(loop.keyframe),
            loop_keyframe=m.frame_index(loop.loop_keyframe),
            scale=float(change.factor[loop.keyframe]),
            matches=len(loop.points),
            cpu_ms=change.cpu_ms,
            relation=relation,
        )

    def _apply_refinement(self, change: Calibrated) -> None:
        """Go on with the refined camera, if the lens was found to differ from it and poses are in one map."""
        self._mapping_cpu_ms += change.cpu_ms
        found, m = change.refinement, change.task.mapper.map
        if found is None or self.state is not TrackingState.TRACKING or not self._may_refine_camera():
            return
        self.camera = replace(self.camera, residual=found.residual)
        found.apply(m)
        for frame in self._frames_in_work():
            frame.features = frame.features.seen_by(self.camera)
            if frame.reference_keyframe >= 0:
                frame.T_cam_map = frame.T_cam_reference @ m.T_cam_map(frame.reference_keyframe)
        self._camera_refined()
        self._emit_at(
            change.task.frame,
            ev.CameraRefined,
            m.map_id,
            k1=found.residual[0],
            k2=found.residual[1],
            shift_px=found.shift_px,
            significance=found.significance,
            keyframes=len(found.adjustment.keyframes),
            cpu_ms=change.cpu_ms,
        )

    def _frames_in_work(self) -> list[Frame]:
        """Frames whose features are still to be used."""
        frames = [self._newest, self.tracker.last, self._backend.newest and self._backend.newest.frame]
        return list({id(frame): frame for frame in frames if frame is not None}.values())

    def _report_refusal(self, change: Refused) -> None:
        m, refusal = change.task.mapper.map, change.refusal
        self._emit_at(
            change.task.frame,
            ev.LoopRefused,
            m.map_id,
            keyframe=m.frame_index(refusal.keyframe),
            loop_keyframe=m.frame_index(refusal.loop_keyframe),
            matches=refusal.matches,
            reason=refusal.reason,
        )

    def _relocalize(self, frame: Frame) -> TrackingOutcome:
        """Relocalize the frame in the map in which tracking was lost."""
        self.state = TrackingState.RELOCALIZING
        return self._relocalize_in([self._map_id], frame)

    def _relocalize_in(self, map_ids: Sequence[int], frame: Frame) -> TrackingOutcome:
        """Relocalize the frame in the first of some maps that recognises it.

        It counts, and tracking goes on there, once the frames that follow have confirmed it.
        """
        outcome = TrackingOutcome(False, 0, 0, "no_candidates")
        if self._probation is not None:
            outcome = self._on_probation(self._probation, map_ids, frame)
        if self._probation is None and not outcome.success:
            for map_id in map_ids:
                outcome = self._begin_probation(map_id, frame)
                if self._probation is not None:
                    break
        return outcome

    def _begin_probation(self, map_id: int, frame: Frame) -> TrackingOutcome:
        """Search a map for the frame; if it is found there, it is on probation."""
        rng = rng_for(self.seed, "relocalization", frame.features.index)
        with self.timer("relocalize"), self._backend.lock:
            found = self._places(map_id).relocalizer.relocalize(frame, rng, self._reach_of(map_id))
            if found.success:
                tracker = Tracker(self._maps[map_id], self.config.tracking, self.timer)
                self._probation = Probation(
                    map_id,
                    frame,
                    found.keyframe,
                    tracker,
                    self.config.probation,
                    self._broken_at[map_id].stamp_s,
                    self._doubted,
                    self._doubts.get(map_id),
                )
        reason = "on_probation" if found.success else found.reason
        return TrackingOutcome(False, found.inliers, found.matches, reason)

    def _reach_of(self, map_id: int) -> Reach | None:
        """Where the camera can be in a map in which tracking was lost; None if unknown."""
        if map_id not in self._reaches:
            path = self._poses.trajectory(map_id, self._maps[map_id])
            self._reaches[map_id] = Reach.of(path, self.config.reach)
        return self._reaches[map_id]

    def _on_probation(self, probation: Probation, map_ids: Sequence[int], frame: Frame) -> TrackingOutcome:
        """Track the frame where an earlier one was relocalized; success if that is now confirmed."""
        if probation.map_id in map_ids:
            with self._backend.lock:
                outcome = probation.offer(frame)
        else:
            outcome = TrackingOutcome(False, 0, 0, "map_in_use")
            probation.withdraw(outcome.reason)
        if probation.verdict is Verdict.WITHDRAWN:
            self._withdraw(probation, frame)
            frame.point[:] = -1
        elif probation.verdict is Verdict.CONFIRMED:
            self._resume(probation, frame, outcome)
        return outcome

    def _withdraw(self, probation: Probation, frame: Frame) -> None:
        """End a probation that was not confirmed; its frames count against the next one."""
        self._probation = None
        self._doubted += tuple(probation.faults)
        self._emit_at(
            frame,
            ev.RelocalizationWithdrawn,
            probation.map_id,
            keyframe=probation.tracker.map.frame_index(probation.keyframe),
            first_frame=probation.first.features.index,
            frames=len(probation.frames),
            reason=probation.reason,
        )

    def _resume(self, probation: Probation, frame: Frame, outcome: TrackingOutcome) -> None:
        """Go on where a relocalization was confirmed."""
        self._probation = None
        if probation.map_id != self._map_id:
            self._enter(probation.map_id)
        self._tracker = probation.tracker
        for tracked in probation.frames:
            self._poses.add(probation.map_id, tracked)
        self.state = TrackingState.TRACKING
        broken = self._broken_at[probation.map_id]
        self._emit(
            frame,
            ev.Relocalized,
            keyframe=self.current_map.frame_index(probation.keyframe),
            first_frame=probation.first.features.index,
            inliers=outcome.inliers,
            frames_lost=frame.features.index - broken.index,
            lost_s=frame.features.stamp_s - broken.stamp_s,
            relation=relocalization_relation(self.current_map, probation.frames),
        )

    def _break(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Handle lost tracking: replace a map with too few keyframes, else start relocalization."""
        self._emit(frame, ev.Breakage, reason=outcome.reason, inliers=outcome.inliers)
        self._withdraw_doubted(frame)
        if self._drop_if_young(frame):
            return
        self._note_break(self._map_id, frame.features)
        self.state = TrackingState.LOST

    def _withdraw_doubted(self, frame: Frame) -> None:
        """Take back what was said and learned since the map is doubted, if it is."""
        doubt, m = self.tracker.doubt, self.current_map
        self._doubts.pop(self._map_id, None)
        if not doubt.reason:
            return
        self._doubts[self._map_id] = doubt
        poses = self._poses.take_back(self._map_id, doubt.first_frame)
        culled = cull_since(m, doubt.first_frame)
        if culled:  # what stays has been adjusted to what goes
            self.mapper.adjust(m.live(culled[-1]))
        self._emit(
            frame,
            ev.PosesWithdrawn,
            first_frame=min(poses, default=doubt.first_frame),
            last_frame=max(poses, default=doubt.first_frame),
            frames=len(poses),
            keyframes=len(culled),
            reason=doubt.reason,
        )

    def _note_break(self, map_id: int, at: FrameFeatures) -> None:
        self._broken_at[map_id] = at
        self._doubted = ()
        self._reaches.pop(map_id, None)

    def _drop_if_young(self, frame: Frame) -> bool:
        if len(self.current_map.keyframes()) > self.config.min_map_keyframes:
            return False
        self._drop(frame, "too_few_keyframes")
        return True

    def _drop(self, frame: Frame, reason: str) -> None:
        """Drop the current map and start a new one."""
        self._emit(frame, ev.MapDropped, reason=reason, keyframes=len(self.current_map.keyframes()))
        self._poses.drop(self._map_id)
        self._forget(self._map_id)
        self._reset_to_new_map()

    def _forget(self, map_id: int) -> None:
        """Release a dropped or absorbed map."""
        del self._maps[map_id]
        self._known_places.pop(map_id, None)
        self._broken_at.pop(map_id, None)
        self._doubts.pop(map_id, None)
        self._reaches.pop(map_id, None)

    def _places(self, map_id: int) -> Places:
        """Place recognition in a map, with loop detection and relocalization."""
        if map_id not in self._known_places:
            self._known_places[map_id] = Places.of(self._maps[map_id], self.config)
        return self._known_places[map_id]

    def _reset_to_new_map(self) -> None:
        self._newest_map_id += 1
        self._map_id = self._newest_map_id
        self._initializer.reset()
        self.state = TrackingState.NOT_INITIALIZED

    def _after_frame(self, frame: Frame, outcome: TrackingOutcome, image: np.ndarray) -> None:
        """Do nothing; a hook for derived systems."""

    def snapshot(self) -> Snapshot[Self]:
        """Copy the whole state between two frames, to branch from any number of times.

        Raises:
            RuntimeError: the system is threaded, and its threads cannot be copied.
        """
        if self._backend.mode is not ExecutionMode.LOCKSTEP:
            raise RuntimeError("a snapshot needs lockstep mode")
        return Snapshot.of(self)

    # -- access from outside -----------------------------------------------------------------------------

    @property
    def settings(self) -> dict:
        """All settings, nested by component, to be saved with the results."""
        return {"mode": str(self._backend.mode), **asdict(self.config)}

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
        """The map in which tracking works."""
        return self._maps[self._map_id]

    @property
    def frames(self) -> int:
        """Number of frames processed so far."""
        return self._frames

    @property
    def current_map_id(self) -> int:
        """Id of the current map, or of the one being initialized."""
        return self._map_id

    def maps(self) -> list[int]:
        """Ids of the existing maps, the one with most tracked frames first."""
        return sorted(self._maps, key=lambda k: (-self._poses.count(k), k))

    def map(self, map_id: int) -> Map:
        """Map by its id."""
        return self._maps[map_id]

    def map_points(self, map_id: int) -> np.ndarray:
        """(n, 3) float64 points of a map, in its own frame."""
        m = self._maps[map_id]
        return m.arrays.pt_xyz[m.points()].copy()

    def trajectories(self) -> list[MapTrajectory]:
        """Poses of the tracked frames in the current maps, the map with most frames first."""
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

    def _result(self, frame: Frame, outcome: TrackingOutcome, is_keyframe: bool) -> TrackingResult:
        mapping_cpu_ms, loop_cpu_ms = self._mapping_cpu_ms, self._loop_cpu_ms
        self._mapping_cpu_ms = self._loop_cpu_ms = 0.0
        T_map_cam = np.linalg.inv(frame.T_cam_map) if outcome.success else None
        inlier_mask = (frame.point >= 0) & outcome.success
        ms, cpu_ms = self.timer.read()
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
            inlier_mask=inlier_mask,
            cpu_ms=cpu_ms,
            ms=ms,
            mapping_cpu_ms=mapping_cpu_ms,
            loop_cpu_ms=loop_cpu_ms,
        )

    def _emit(self, frame: Frame, kind: type[ev.Event], **fields) -> None:
        self._emit_at(frame, kind, self._map_id, **fields)

    def _emit_at(self, frame: Frame, kind: type[ev.Event], map_id: int, **fields) -> None:
        features = frame.features
        self.events.append(kind(frame=features.index, stamp_s=features.stamp_s, map_id=map_id, **fields))
