"""Dual-SLAM as a framework over any odometry: a breakage is answered by a recovery backward in time.

Source: Huang et al., "Dual-SLAM: A framework for robust single camera navigation", IROS 2020, Sec. III and
Algorithm 1. Ours: maps are joined by the trajectories that they share with the recovery's, as these are all
that every system has; and a system that can find back by itself goes on trying.
"""

from collections import deque
from collections.abc import Sequence as Many
from dataclasses import asdict, replace
from typing import Any, Self

import numpy as np

from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.core.frame_input import check_frame
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.core.seeds import rng_for
from dslab.slam.core.settings import setting, settings
from dslab.slam.core.snapshot import Snapshot
from dslab.slam.framework.alignment import SeamConfig
from dslab.slam.framework.odometry import Fed, GivenFrame, Kind
from dslab.slam.framework.pieces import JoinedMap
from dslab.slam.framework.recovery import Recovered, recover
from dslab.slam.optimization.sim3 import moved

_NO_FEATURES = np.empty((0, 2), np.float32), np.empty(0, bool)


@settings
class FrameworkConfig:
    """Settings of Dual-SLAM over any odometry."""

    buffer_s: float = setting(10.0, "span of the frames kept; the paper finds 10 s to work well", gt=0)
    buffer_cap_s: float = setting(30.0, "most that they grow to while a recovery is due", gt=0)
    least_poses: int = setting(10, "poses of a map that is kept at a breakage", ge=1)
    start_poses: int = setting(30, "poses of the new map at which a recovery starts", ge=20)
    starts: int = setting(3, "times that it starts, each with twice the poses, until it succeeds", ge=1)
    lost_systems: int = setting(2, "lost systems that go on trying to find back, the largest maps first")
    exhaustive: bool = setting(False, "run every recovery thread, also after one has succeeded")
    seam: SeamConfig = setting(SeamConfig(), "how well an alignment has to be known")


class DualOf:
    """Dual-SLAM over an odometry.

    Args:
        camera: of the images to come.
        seed: root of every random stream.
        forward: the odometry.
        recoveries: of the recovery threads, in order; the forward one if none is given.
        config: settings.

    Attributes:
        events: all events so far.
        frames: number of frames processed so far.
        takes_exposure: ``process`` takes the exposures of images, where they are known.
    """

    takes_exposure = True
    config = None  # of our base: it may be any other system

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int,
        forward: Kind,
        recoveries: Many[Kind] = (),
        config: FrameworkConfig | None = None,
    ) -> None:
        self.forward, self.recoveries = forward, tuple(recoveries) or (forward,)
        self.framework = config or FrameworkConfig()
        self.events: list[ev.Event] = []
        self.frames = 0
        self.state = TrackingState.NOT_INITIALIZED
        self._camera, self._seed, self._begun, self._next_id = camera, seed, 0, 0
        self._stamps_s: list[float] = []
        self._buffer: deque[GivenFrame] = deque()
        self._maps: dict[int, JoinedMap] = {}
        self._saved: list[int] = []  # ids of maps that a recovery may reach, the newest last
        self._lost: list[tuple[int, Fed]] = []  # systems that may find back, with their maps
        self._held = False  # between a cut and a restart
        self._begin(0)

    # -- Sec. III of the paper ---------------------------------------------------------------------------

    def process(self, image: np.ndarray, stamp_s: float, exposure_s: float | None = None) -> TrackingResult:
        """Process one frame; as :meth:`slam.system.MonocularSystem.process`."""
        frame = self._receive(image, stamp_s, exposure_s)
        if self._held:
            return self._result(frame, None, "held")
        if (back := self._found_back(frame)) is not None:
            return self._result(frame, back)
        fed, was_begun = self._fed, self._fed.is_begun
        reason = fed.feed(frame)
        self.events += fed.news(self._map_id)
        if reason:
            self._save(frame, reason)  # Sec. III-A: the map is saved, another one is begun
            return self._result(frame, fed, reason)
        if fed.is_begun and not was_begun and self._since is not None:
            self._emit(frame, ev.ReinitDone, frames_taken=frame.index - self._since)
        if self._is_due(self._due):
            self._recover(frame)  # Sec. III-B and III-C
        return self._result(frame, fed)

    def finish(self) -> None:
        """End the input: a recovery whose new map is still short starts all the same."""
        if self._buffer and not self._held and self._is_due(self.framework.least_poses):
            self._recover(self._buffer[-1])
        for fed in [piece.fed for m in self._maps.values() for piece in m.pieces if piece.fed is not None]:
            fed.finish()

    def _receive(self, image: np.ndarray, stamp_s: float, exposure_s: float | None) -> GivenFrame:
        last_s = self._stamps_s[-1] if self._stamps_s else -np.inf
        check_frame(image, stamp_s, self._camera, self.frames, last_s)
        frame = GivenFrame(self.frames, stamp_s, image.copy(), () if exposure_s is None else (exposure_s,))
        self.frames += 1
        self._stamps_s.append(stamp_s)
        self._buffer.append(frame)
        span_s = self.framework.buffer_cap_s if self._saved else self.framework.buffer_s
        while stamp_s - self._buffer[0].stamp_s > span_s:
            self._buffer.popleft()
        oldest = self._buffer[0].index
        self._saved = [k for k in self._saved if self._maps[k].newest >= oldest]
        return frame

    def _begin(self, first: int) -> None:
        """Begin a system on the frames from one on, in a map of its own."""
        self._map_id = self._next_id  # never given twice: what is told of a dropped map stays told
        self._next_id += 1
        self._fed = Fed(self.forward, self._next_seed(), first)
        self._maps[self._map_id] = JoinedMap(self._map_id, self._fed)
        self._since = first if first else None
        self._due, self._starts = self.framework.start_poses, 0

    def _next_seed(self) -> int:
        """That of the first system is the whole's, so that both are alike until the first breakage."""
        self._begun += 1
        if self._begun == 1:
            return self._seed
        return int(rng_for(self._seed, "system", self._begun).integers(2**31))

    def _save(self, frame: GivenFrame, reason: str) -> None:
        """Save the map at a loss, or drop it if it has too few poses, and begin another system."""
        self._emit(frame, ev.Breakage, reason=reason, inliers=0)
        m, returns = self._maps[self._map_id], self._fed.parts.returns
        if not returns:
            self._fed.finish()
        if m.note() < self.framework.least_poses:
            self._emit(frame, ev.MapDropped, reason="too_few_poses", keyframes=len(m.keyframes()))
            del self._maps[self._map_id]
            self._fed.finish()
        else:
            self._emit(frame, ev.MapSaved, keyframes=len(m.keyframes()), points=len(m.points()))
            self._saved.append(self._map_id)
            if returns:
                lost = [*self._lost, (self._map_id, self._fed)]
                largest = sorted(lost, key=lambda each: -self._maps[each[0]].size)
                self._lost = largest[: self.framework.lost_systems]
        self._begin(frame.index + 1)
        self._emit(frame, ev.ReinitStart)

    def _found_back(self, frame: GivenFrame) -> Fed | None:
        """Give a frame to the lost systems; one that has found back goes on, and its map with it."""
        for map_id, fed in self._lost:
            reason, news = fed.feed(frame), fed.news(map_id)
            if reason:
                continue
            self.events += news
            self._set_aside()
            self._lost.remove((map_id, fed))
            self._saved = [k for k in self._saved if k != map_id]
            self._map_id, self._fed, self._since = map_id, fed, None
            return fed
        return None

    def _set_aside(self) -> None:
        """Give up the system at work for one that has found back; what it has of its map stays."""
        self._fed.finish()
        if self._maps[self._map_id].note() < self.framework.least_poses:
            del self._maps[self._map_id]

    # -- Algorithm 1 -------------------------------------------------------------------------------------

    def _is_due(self, poses: int) -> bool:
        """True if a saved map can be reached and the new one has so many poses."""
        if not self._saved or not self._fed.is_begun or self._starts >= self.framework.starts:
            return False
        return len(self._fed.frames) >= poses and len(self._maps[self._map_id].poses()) >= poses

    def _recover(self, frame: GivenFrame) -> None:
        """Run the recovery threads backward over the buffer, and fuse what the first that succeeds joins."""
        self._starts, self._due = self._starts + 1, 2 * self._due
        new, saved = self._maps[self._map_id], [self._maps[k] for k in reversed(self._saved)]
        found: Recovered | None = None
        for thread, kind in enumerate(self.recoveries, 1):
            about: dict[str, Any] = {"thread": thread, "method": kind.name, "old_map_id": saved[0].map_id}
            self._emit(frame, ev.RecoveryStart, **about, buffered_frames=len(self._buffer))
            one = recover(kind, self._next_seed(), list(self._buffer), new, saved, self.framework.seam)
            if one.old is not None:
                about["old_map_id"] = one.old.map_id
            self._emit(frame, ev.RecoveryEnd, **about, success=one.old is not None, **one.told())
            found = found if found is not None or one.old is None else one
            if found is not None and not self.framework.exhaustive:
                break
        if found is not None and found.old is not None:
            self._fuse(frame, found, found.old, new)

    def _fuse(self, frame: GivenFrame, found: Recovered, old: JoinedMap, new: JoinedMap) -> None:
        """Move the new map into the old one; between them the poses of the recovery stand."""
        relation, withdrawn = found.relation(), found.replaced
        old.join(new, found.S_old_new, found.bridge, found.replaced)
        del self._maps[new.map_id]
        self._map_id = old.map_id
        self._saved.remove(old.map_id)
        for lost in [lost for lost in self._lost if lost[0] == old.map_id]:
            self._lost.remove(lost)
        if withdrawn:
            self._emit(
                frame, ev.PosesWithdrawn, first_frame=min(withdrawn), last_frame=max(withdrawn),
                frames=len(withdrawn), keyframes=0, reason="passed_over_by_recovery",
            )  # fmt: skip
        self._emit(
            frame, ev.Fusion, relation=relation, old_map_id=old.map_id, new_map_id=new.map_id, by="recovery",
            accepted=True, scale=found.scale, inliers=found.to_old.poses, reason="",
        )  # fmt: skip

    # -- laboratory --------------------------------------------------------------------------------------

    def cut(self) -> None:
        """Save the healthy map as at a breakage, then only keep frames until :meth:`restart`.

        Raises:
            RuntimeError: no map is being tracked.
        """
        if self.state is not TrackingState.TRACKING:
            raise RuntimeError("there is no healthy map to cut")
        self._emit(self._buffer[-1], ev.MapCut)
        self._maps[self._map_id].note()
        self._saved.append(self._map_id)
        self._held, self.state = True, TrackingState.LOST

    def restart(self) -> None:
        """Begin a new system on the next frame, after :meth:`cut`.

        Raises:
            RuntimeError: there was no cut before.
        """
        if not self._held:
            raise RuntimeError("restart without a cut")
        self._held = False
        self._begin(self.frames)
        self._emit(self._buffer[-1], ev.ReinitStart)

    def snapshot(self) -> Snapshot[Self]:
        """Copy the whole state between two frames, to branch from any number of times."""
        return Snapshot.of(self)

    # -- what is seen from outside -----------------------------------------------------------------------

    @property
    def camera(self) -> PinholeCamera:
        """The camera, as the system at work has refined it."""
        return self._fed.system.camera

    @property
    def settings(self) -> dict[str, Any]:
        """All settings, and which systems it is made of."""
        made_of = {"forward": self.forward.name, "recoveries": [kind.name for kind in self.recoveries]}
        return made_of | asdict(self.framework)

    def maps(self) -> list[int]:
        """Ids of the maps with poses, the one with most frames first."""
        sizes = {k: m.size for k, m in self._maps.items() if m.note()}
        return sorted(sizes, key=lambda k: (-sizes[k], k))

    def map_points(self, map_id: int) -> np.ndarray:
        """(N, 3) float64 points of a map, as far as its systems have some."""
        return self._maps[map_id].points()

    def map(self, map_id: int) -> Any:
        """Raises ValueError: maps of features are not known."""
        raise ValueError(f"map {map_id}: only poses are known of this system")

    def trajectories(self) -> list[MapTrajectory]:
        """Poses of the frames, the map with most first."""
        return [self._path(k, self._maps[k].poses()) for k in self.maps()]

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        """Poses of the keyframes that are known, in the order of :meth:`trajectories`."""
        paths = []
        for k in self.maps():
            poses, made = self._maps[k].poses(), set(self._maps[k].keyframes())
            paths.append(self._path(k, {f: T for f, T in poses.items() if f in made}))
        return paths

    def _path(self, map_id: int, poses: dict[int, np.ndarray]) -> MapTrajectory:
        frames = sorted(poses)
        stamps_s = np.array([self._stamps_s[f] for f in frames])
        T = np.array([poses[f] for f in frames]).reshape(-1, 4, 4)
        return MapTrajectory(map_id, np.array(frames, int), stamps_s, T)

    def _result(self, frame: GivenFrame, fed: Fed | None, reason: str = "") -> TrackingResult:
        """The outcome of a frame: what a system said of it, its pose in the joined map unless it is lost."""
        said = fed.result if fed is not None else None
        T = said.T_map_cam if said is not None and not reason else None
        if T is not None and fed is not None:
            T = moved(self._maps[self._map_id].S_of(fed), T)
        begun = len(self._maps) > 1 or self._fed.is_begun
        lost = TrackingState.LOST if begun else TrackingState.NOT_INITIALIZED
        self.state = lost if T is None else TrackingState.TRACKING
        said = said or TrackingResult(0, 0.0, self.state, None, 0, 0, 0, reason, False, *_NO_FEATURES)
        return replace(
            said, frame=frame.index, stamp_s=frame.stamp_s, state=self.state, T_map_cam=T, relative=None,
            map_id=self._map_id, reason=reason or said.reason, is_keyframe=said.is_keyframe and T is not None,
        )  # fmt: skip

    def _emit(self, frame: GivenFrame, kind: type[ev.Event], **fields: Any) -> None:
        self.events.append(kind(frame=frame.index, stamp_s=frame.stamp_s, map_id=self._map_id, **fields))
