"""Direct sparse odometry as a system: images in, poses and events out.

A lost camera starts a new map; the old one stays as it is, unless it is too young to be kept.
"""

from collections import deque
from dataclasses import asdict, replace
from typing import Self

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.core.frame_input import check_frame
from dslab.slam.core.results import MapTrajectory, PhotometricView, TrackingResult
from dslab.slam.core.seeds import rng_for
from dslab.slam.core.snapshot import Snapshot
from dslab.slam.core.timing import StageTimer
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.ldso.config import DsoConfig
from dslab.slam.ldso.corners import corner_view
from dslab.slam.ldso.loops import LoopCloser
from dslab.slam.ldso.loss import reason_of_loss
from dslab.slam.ldso.odometry import Odometry
from dslab.slam.ldso.replay import Replayed, replayed
from dslab.slam.ldso.start import Starter, Waiting
from dslab.slam.ldso.tracking import Tracked
from dslab.slam.map.map import Map

_USED = ("orb", "initial_features", "initialization", "mapping", "loops")  # of the settings of the base


class DsoSlam:
    """Direct sparse odometry.

    Args:
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings of the base, of which the first map from two views and the loops have theirs.
        dso: settings of the odometry.
        loops: whether places are recognised and loops closed.

    Attributes:
        camera: the camera.
        config, dso: settings.
        events: all events so far.
        state: of tracking.
        frames: number of frames processed so far.
        current_map_id: id of the current map, or of the one being initialized.
        takes_exposure: ``process`` takes the exposures of images, where they are known.
    """

    takes_exposure = True

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int = 0,
        config: SlamConfig | None = None,
        dso: DsoConfig | None = None,
        loops: bool = False,
    ) -> None:
        self.camera = camera
        self.config, self.dso = config or SlamConfig(), dso or DsoConfig()
        self.events: list[ev.Event] = []
        self.state = TrackingState.NOT_INITIALIZED
        self.frames = 0
        self.current_map_id = 0
        self._rectifier = Rectifier(camera)
        self._corner_view = corner_view(camera, self.dso.corners) if loops else None
        self._seed = seed
        self._starter = self._new_starter()
        self._maps: dict[int, Odometry] = {}
        self._closers: dict[int, LoopCloser] = {}
        self._timer = StageTimer()
        self._mapping_ms = self._loop_ms = 0.0
        self._last_stamp_s = -np.inf
        self._first_exposure_s: float | None = None
        self._sought_since = 0
        self._recent: deque[Waiting] = deque(maxlen=self.dso.lens.most_replayed)

    # -- a frame -----------------------------------------------------------------------------------------

    def process(self, image: np.ndarray, stamp_s: float, exposure_s: float | None = None) -> TrackingResult:
        """Process one frame.

        Args:
            image: (H, W) uint8 grey image of the camera's size.
            stamp_s: its time, later than the last one's.
            exposure_s: its shutter time, positive, to which its brightness is proportional; None if unknown.

        Returns:
            The outcome of the frame.

        Raises:
            ValueError: on misuse: wrong size or type of image, time not increasing, no positive exposure.
                The content of an image never raises.
        """
        self._timer.begin()
        check_frame(image, stamp_s, self.camera, self.frames, self._last_stamp_s)
        exposure = self._exposure(exposure_s)
        self._last_stamp_s = stamp_s
        index = self.frames
        self.frames += 1
        item = Waiting(index, stamp_s, image.copy(), exposure)
        if self._recent.maxlen:
            self._recent.append(item)
        return self._track(item) if self.state is TrackingState.TRACKING else self._start(item)

    def _exposure(self, exposure_s: float | None) -> float:
        """Logarithm of an exposure over the first one."""
        if exposure_s is None:
            return 0.0
        if not 0 < exposure_s < np.inf:
            raise ValueError(f"exposure_s must be positive and finite, is {exposure_s}")
        if self._first_exposure_s is None:
            self._first_exposure_s = exposure_s
        return float(np.log(exposure_s / self._first_exposure_s))

    def _start(self, item: Waiting) -> TrackingResult:
        index, stamp_s = item.frame, item.stamp_s
        with self._timer("initialize"):
            found = self._starter.offer(item, self.current_map_id)
        if found.odometry is None:
            return self._result(index, stamp_s, None, found.matches, found.reason)
        self._take_map(found.odometry)
        self.state = TrackingState.TRACKING
        points = len(found.odometry.window.active)
        self._emit(index, stamp_s, ev.Initialized, points=points, model=found.model)
        if self.current_map_id:
            taken = index - self._sought_since
            self._emit(index, stamp_s, ev.ReinitDone, frames_taken=taken)
        return self._result(index, stamp_s, found.odometry, points, "", True)

    def _track(self, item: Waiting) -> TrackingResult:
        index, stamp_s, image = item.frame, item.stamp_s, item.image
        odometry = self._maps[self.current_map_id]
        with self._timer("pyramid"):
            pyramid = self._rectifier.pyramid(image)
        with self._timer("align"):
            tracked = odometry.track(pyramid, item.exposure)
        uncertainty = odometry.uncertainty(tracked) if tracked is not None else np.inf
        reason = reason_of_loss(tracked, uncertainty, self.dso.loss)
        if tracked is None or reason:
            if odometry.pass_over():
                return self._result(index, stamp_s, None, 0, reason)
            self._break(index, stamp_s, odometry, reason)
            return self._result(index, stamp_s, None, 0, reason)
        with self._timer("search"):
            wanted = odometry.take(index, stamp_s, pyramid, tracked)
        if wanted:
            reason = self._map(index, stamp_s, odometry, image, pyramid, tracked)
            if reason:
                self._break(index, stamp_s, odometry, reason)
                return self._result(index, stamp_s, None, 0, reason)
            odometry = self._maps[self.current_map_id]
        seen = round(tracked.visible * (1 - tracked.saturated) * len(odometry.window.active))
        return self._result(index, stamp_s, odometry, seen, "", wanted)

    def _map(
        self,
        index: int,
        stamp_s: float,
        odometry: Odometry,
        image: np.ndarray,
        pyramid: ImagePyramid,
        tracked: Tracked,
    ) -> str:
        """Make a keyframe; why the map is lost with it, if it is."""
        timer = StageTimer()
        timer.begin()
        with self._timer.apart(), timer("mapping"):
            odometry.add_keyframe(index, stamp_s, image, pyramid, tracked)
        self._mapping_ms = timer.cpu_ms["mapping"]
        left = odometry.left
        with self._timer.apart():
            begun_anew = self._refine_lens(index, stamp_s, odometry)
        if begun_anew is not None:
            odometry, left = begun_anew.odometry, begun_anew.left
        if len(odometry.window.active) < self.dso.loss.least_points:
            return "too_few_points"
        if self._corner_view is not None:
            with self._timer.apart():
                for row in left:
                    self._close_loop(index, stamp_s, odometry, row)
        return ""

    def _refine_lens(self, index: int, stamp_s: float, odometry: Odometry) -> Replayed | None:
        """Change the lens if the windows so far say that it is another one; the map, if it was begun anew."""
        timer = StageTimer()
        timer.begin()
        with timer("lens"):
            change = odometry.lens.change(self.dso.window.most / max(1, self.dso.lens.every))
            if change is None:
                return None
            self.camera = replace(self.camera, residual=change.residual)
            self._rectifier = Rectifier(self.camera)
            self._starter = self._new_starter()
            begun_anew = self._begin_anew(odometry)
            if begun_anew is None:
                odometry.see_through(self.camera, self._rectifier)
                if self._corner_view is not None:
                    self._closers[self.current_map_id].see_through(self.camera)
        self._recent = deque(maxlen=0)
        self._mapping_ms += timer.cpu_ms["lens"]
        k1, k2, p1, p2 = change.residual
        self._emit(
            index, stamp_s, ev.CameraRefined, k1=k1, k2=k2, p1=p1, p2=p2, readout_s=0.0,
            shift_px=change.shift_px, significance=change.significance, keyframes=len(odometry.keyframes),
            cpu_ms=timer.cpu_ms["lens"],
        )  # fmt: skip
        return begun_anew

    def _begin_anew(self, odometry: Odometry) -> Replayed | None:
        """Begin the current map anew with the lens as it is known now, if all its frames are at hand."""
        first = odometry.keyframes[0].frame
        frames = [item for item in self._recent if item.frame >= first]
        if not frames or frames[0].frame != first:
            return None
        found = replayed(frames, self._starter, self._rectifier, self.current_map_id)
        self._starter.reset()
        if found is None or not set(odometry.frames) <= set(found.odometry.frames):
            return None
        self._take_map(found.odometry)
        return found

    def _take_map(self, odometry: Odometry) -> None:
        """Make this the current map."""
        self._maps[self.current_map_id] = odometry
        if self._corner_view is not None:
            self._closers[self.current_map_id] = LoopCloser(
                odometry, self.current_map_id, self._corner_view, self.config, self.dso.corners
            )

    def _new_starter(self) -> Starter:
        return Starter(
            self.camera, self._rectifier.intrinsics, self._rectifier.pyramid, self._seed, self.config,
            self.dso, self._corner_view,
        )  # fmt: skip

    def _close_loop(self, index: int, stamp_s: float, odometry: Odometry, row: int) -> None:
        """Recognise the place of a keyframe that has left the window."""
        rng = rng_for(self._seed, "loop", odometry.keyframes[row].frame)
        timer = StageTimer()
        timer.begin()
        with timer("loop"):
            closed, refused = self._closers[self.current_map_id].offer(row, rng)
        self._loop_ms += timer.cpu_ms["loop"]
        for loop in refused:
            self._emit(index, stamp_s, ev.LoopRefused, **vars(loop))
        if closed is not None:
            self._emit(index, stamp_s, ev.LoopClosed, **vars(closed), cpu_ms=timer.cpu_ms["loop"])

    def _break(self, index: int, stamp_s: float, odometry: Odometry, reason: str) -> None:
        """Declare the map broken and seek a new one."""
        self._emit(index, stamp_s, ev.Breakage, reason=reason, inliers=0)
        odometry.forget(index)
        keyframes = len(odometry.keyframes)
        if keyframes <= self.dso.loss.min_keyframes:
            self._emit(index, stamp_s, ev.MapDropped, reason="too_few_keyframes", keyframes=keyframes)
            del self._maps[self.current_map_id]
            self._closers.pop(self.current_map_id, None)
        else:
            points = len(odometry.points())
            self._emit(index, stamp_s, ev.MapSaved, keyframes=keyframes, points=points)
            odometry.close()
        self.current_map_id += 1
        self.state = TrackingState.NOT_INITIALIZED
        self._sought_since = index
        self._starter.reset()
        self._emit(index, stamp_s, ev.ReinitStart)

    def _result(
        self,
        index: int,
        stamp_s: float,
        odometry: Odometry | None,
        inliers: int,
        reason: str,
        is_keyframe: bool = False,
    ) -> TrackingResult:
        T = np.linalg.inv(odometry.pose(index)) if odometry is not None else None
        keypoints, mask = np.empty((0, 2), np.float32), np.empty(0, bool)
        if odometry is not None:
            keypoints = self.camera.distort_points(odometry.pixels(index)).astype(np.float32)
            mask = np.ones(len(keypoints), bool)
        ms, cpu_ms = self._timer.read()
        mapping_ms, loop_ms = self._mapping_ms, self._loop_ms
        is_passed_over = odometry is None and self.state is TrackingState.TRACKING
        self._mapping_ms = self._loop_ms = 0.0
        return TrackingResult(
            frame=index,
            stamp_s=stamp_s,
            state=TrackingState.LOST if is_passed_over else self.state,
            T_map_cam=T,
            map_id=self.current_map_id,
            inliers=inliers,
            matches=inliers,
            reason=reason,
            is_keyframe=is_keyframe,
            keypoints_px=keypoints,
            inlier_mask=mask,
            cpu_ms=cpu_ms,
            ms=ms,
            mapping_cpu_ms=mapping_ms,
            loop_cpu_ms=loop_ms,
        )

    def _emit(self, index: int, stamp_s: float, kind: type[ev.Event], **fields) -> None:
        self.events.append(kind(frame=index, stamp_s=stamp_s, map_id=self.current_map_id, **fields))

    # -- what is seen from outside -----------------------------------------------------------------------

    def finish(self) -> None:
        """End the input; nothing is pending."""

    def snapshot(self) -> Snapshot[Self]:
        """Copy the whole state between two frames, to branch from any number of times."""
        return Snapshot.of(self)

    @property
    def settings(self) -> dict:
        """All settings, nested by component, to be saved with the results."""
        used = {name: value for name, value in asdict(self.config).items() if name in _USED}
        return {"mode": "lockstep", **used, "dso": asdict(self.dso)}

    def maps(self) -> list[int]:
        """Ids of the existing maps, the one with most tracked frames first."""
        return sorted(self._maps, key=lambda k: (-len(self._maps[k].frames), k))

    def map_points(self, map_id: int) -> np.ndarray:
        """(n, 3) float64 points of a map, in its own frame."""
        return self._maps[map_id].points()

    def photometric_view(self, image: np.ndarray) -> PhotometricView | None:
        """The residuals of the frame processed last, and the window; None unless it is tracked.

        Args:
            image: (H, W) uint8 that frame.
        """
        odometry = self._maps.get(self.current_map_id)
        if odometry is None or self.frames - 1 not in odometry.frames:
            return None
        uv, residual = odometry.residuals(self.frames - 1, self._rectifier.pyramid(image))
        window = odometry.window
        return PhotometricView(
            keyframes=tuple(window.keyframes[slot].frame for slot in window.slots),
            pixels_px=self.camera.distort_points(uv).astype(np.float32),
            residual=residual.astype(np.float32),
        )

    def trajectories(self) -> list[MapTrajectory]:
        """Poses of the tracked frames, relative to their keyframes as they are; see :meth:`maps`."""
        return [self._maps[k].trajectory(k) for k in self.maps()]

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        """Poses of the keyframes, in the order of :meth:`trajectories`."""
        return [self._maps[k].keyframe_trajectory(k) for k in self.maps()]

    def map(self, map_id: int) -> Map:
        """Raises ValueError: its maps have no features, so they are none of the other systems' kind."""
        raise ValueError(f"map {map_id} of direct sparse odometry has no features")
