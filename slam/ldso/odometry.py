"""Direct sparse odometry in one map: frames tracked, keyframes made.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.
Ours: where a frame is expected (:mod:`slam.ldso.motion`) and what a point counts for in the reference.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from dslab.slam.core.camera import PinholeCamera, distort_residual, undistort_residual
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.core.results import MapTrajectory
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.direct.rays import LEAST_NOISE
from dslab.slam.direct.selection import select
from dslab.slam.direct.turn import level_of, turn_between
from dslab.slam.ldso.activation import activate
from dslab.slam.ldso.adjustment import adjust
from dslab.slam.ldso.brightness import composed, relative
from dslab.slam.ldso.config import DsoConfig
from dslab.slam.ldso.corners import described, with_corners
from dslab.slam.ldso.lens import LensEstimator
from dslab.slam.ldso.marginalisation import leaving, remove_keyframe, remove_points
from dslab.slam.ldso.motion import SHARED, MotionFilter
from dslab.slam.ldso.points import Immature
from dslab.slam.ldso.tracking import SURE, Expected, PhotometricTracker, Tracked, TrackingReference
from dslab.slam.ldso.window import Keyframe, Window
from dslab.slam.optimization.sim3 import sim3_decompose

_LEAST_WEIGHT = 1e-3  # of a point whose depth no residual determines
_MORE_UNLIKE = 2.0  # than the last frame, with which other guesses are tried
_FIRST_ERROR = 4.0  # of a frame before any is tracked, of 255


@dataclass(frozen=True)
class PlacedFrame:
    """A frame, placed relative to its reference keyframe.

    Attributes:
        frame: its index.
        stamp_s: its time.
        keyframe: row of the keyframe in the map.
        T_cam_keyframe: (4, 4) keyframe's camera to frame's.
    """

    frame: int
    stamp_s: float
    keyframe: int
    T_cam_keyframe: np.ndarray


def _weighed(tracked: Tracked) -> np.ndarray:
    """(6, 6) information of a frame's image on its pose, for the residuals that it has."""
    return tracked.information / (SHARED * max(tracked.error, LEAST_NOISE) ** 2)


class Odometry:
    """A map that grows with the camera.

    Args:
        camera: of the images.
        intrinsics: (L, 4) of the levels of their pyramids.
        config: settings.
        view: of the corners by which places are recognised; None if they are not.

    Attributes:
        window: keyframes that are adjusted.
        keyframes: all keyframes, in order of time.
        frames: all frames that were placed, by index.
        left: rows of the keyframes that have left the window with the newest one.
        lens: what the windows say of the lens.
        motion: what is expected of the next frame.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        intrinsics: np.ndarray,
        config: DsoConfig,
        view: ViewGeometry | None = None,
    ) -> None:
        self.config = config
        self.intrinsics = intrinsics
        self.window = Window(camera, intrinsics, config.window)
        self.keyframes: list[Keyframe] = []
        self.frames: dict[int, PlacedFrame] = {}
        self.left: list[int] = []
        self.lens = LensEstimator(camera, config.lens)
        self.motion = MotionFilter()
        self._camera = camera
        self._tracker = PhotometricTracker(config.photometric, config.tracking)
        self._corner_view = view
        self._reference: TrackingReference | None = None
        self._first_error = np.nan  # of the first frame after the keyframe
        self._last_error, self._last_likeness = _FIRST_ERROR, 1.0
        self._affine = np.zeros(2)  # of the last frame relative to the reference
        self._exposure = 0.0  # of the last frame
        self._last_view: np.ndarray | None = None  # of the last frame, on the level on which turns are sought
        self._carried: np.ndarray | None = None  # pose of the last frame, if it was passed over

    # -- tracking ----------------------------------------------------------------------------------------

    def track(self, pyramid: ImagePyramid, exposure: float = 0.0) -> Tracked | None:
        """Align a frame with the newest keyframe; None if they have too little in common.

        Args:
            pyramid: of the frame.
            exposure: logarithm of its exposure over that of the first image; 0 where it is not known.
        """
        if self._reference is None:
            raise RuntimeError("there is no keyframe yet")
        usual = min(SURE, 1.0 - _MORE_UNLIKE * (1.0 - self._last_likeness))
        affine = self._affine + np.array([exposure - self._exposure, 0.0])
        more = exposure - self.keyframes[-1].exposure
        self._exposure = exposure
        T, covariance = self.motion.ahead(self._last_pose(), self.depth)
        T = T @ np.linalg.inv(self.window.T_cam_map[self.window.newest])
        variance = SHARED * max(self._last_error, LEAST_NOISE) ** 2
        expected = Expected(T, np.linalg.inv(covariance), variance)
        return self._tracker.track(
            self._reference, pyramid, self._guesses(T, pyramid), affine, usual, more, expected
        )

    def take(self, frame: int, stamp_s: float, pyramid: ImagePyramid, tracked: Tracked) -> bool:
        """Take a tracked frame: narrow the depths of points by it; True if it should become a keyframe."""
        T = tracked.T_frame_ref @ self.window.T_cam_map[self.window.newest]
        self.motion.take(self._last_pose(), T, _weighed(tracked), self.depth)
        self._carried = None
        self.place(frame, stamp_s, tracked.T_frame_ref)
        self._last_view = pyramid.levels[level_of(pyramid)][..., 0]
        self._affine = tracked.affine
        self._last_error, self._last_likeness = tracked.error, tracked.likeness
        if np.isnan(self._first_error):
            self._first_error = max(tracked.error, 1.0)
        affine = composed(tracked.affine, self.window.affine[self.window.newest])
        self.search(pyramid, T, affine, tracked.error)
        demand = tracked.demand(self._camera.width_px, self._camera.height_px, self.config.keyframes)
        return demand > 1.0 or tracked.error > self.config.keyframes.most_error * self._first_error

    def pass_over(self) -> bool:
        """Go on by a frame that shows nothing of the map; False if the pose is not known then any more."""
        if not self.motion.unseen() < self.config.loss.max_uncertainty:
            return False
        self._carried, _ = self.motion.ahead(self._last_pose(), self.depth)
        self.motion.pass_over()
        return True

    def place(self, frame: int, stamp_s: float, T_cam_keyframe: np.ndarray) -> None:
        """Keep the pose of a frame relative to the newest keyframe."""
        self.frames[frame] = PlacedFrame(frame, stamp_s, len(self.keyframes) - 1, T_cam_keyframe)

    def search(self, pyramid: ImagePyramid, T_cam_map: np.ndarray, affine: np.ndarray, noise: float) -> None:
        """Search points whose depth is not known yet in a view of known pose, brightness and noise."""
        w = self.window
        motions = T_cam_map @ np.linalg.inv(w.T_cam_map)
        affines = np.stack([relative(affine, own) for own in w.affine])
        photometric = self.config.photometric
        w.immature.search(pyramid, self.intrinsics[0], motions, affines, noise, photometric)

    def _guesses(self, expected: np.ndarray, pyramid: ImagePyramid) -> Iterator[np.ndarray]:
        """Motions from the newest keyframe that are tried: the expected one, none, and turned ones."""
        last = self._newest_frames()[0] @ np.linalg.inv(self.window.T_cam_map[self.window.newest])
        yield expected
        yield last
        if self._last_view is not None:
            level = level_of(pyramid)
            yield turn_between(self._last_view, pyramid.levels[level][..., 0], self.intrinsics[level]) @ last

    def _last_pose(self) -> np.ndarray:
        """(4, 4) map to camera, of the last frame; as expected if it was passed over."""
        return self._newest_frames()[0] if self._carried is None else self._carried

    def _newest_frames(self) -> tuple[np.ndarray, np.ndarray]:
        """(4, 4) poses, map to camera, of the last two frames that have one, the newest first."""
        newest = [self.pose(index) for index in islice(reversed(self.frames), 2)]
        return newest[0], newest[-1]

    def begin_motion(self) -> None:
        """Expect that the camera goes on as in the last two frames."""
        last, before = self._newest_frames()
        self.motion.begin(before, last, self.depth)

    def pose(self, frame: int) -> np.ndarray:
        """(4, 4) pose of a frame, map to camera."""
        placed = self.frames[frame]
        return placed.T_cam_keyframe @ self.keyframes[placed.keyframe].T_cam_map

    def uncertainty(self, tracked: Tracked) -> float:
        """Largest standard deviation of a tracked frame's pose, in usual depths and rad."""
        return self.motion.uncertainty(_weighed(tracked))

    @property
    def depth(self) -> float:
        """Usual depth of points in the newest keyframe."""
        return self._reference.depth if self._reference is not None else 1.0

    # -- keyframes ---------------------------------------------------------------------------------------

    def add_keyframe(
        self, frame: int, stamp_s: float, image: np.ndarray, pyramid: ImagePyramid, tracked: Tracked
    ) -> None:
        """Make a tracked frame a keyframe: activate points, adjust the window, marginalise.

        Args:
            frame, stamp_s: its index and time.
            image, pyramid: (H, W) uint8 as taken, and its pyramid.
            tracked: where it is.
        """
        w, config = self.window, self.config
        T = tracked.T_frame_ref @ w.T_cam_map[w.newest]
        affine = composed(tracked.affine, w.affine[w.newest])
        out = leaving(w, T)
        keyframe = Keyframe(frame, stamp_s, T, image=image.copy(), exposure=self._exposure)
        self.insert(keyframe, pyramid, affine)
        activate(w, config.photometric)
        adjust(w, config.photometric)
        self.lens.take(w, config.photometric)
        remove_points(w, out, config.photometric)
        self.left = self.rows_of(out)
        for slot in out:
            remove_keyframe(w, slot, config.photometric)
        self.refer(pyramid)
        self.select(pyramid, 1.0 / self.depth)

    def insert(self, keyframe: Keyframe, pyramid: ImagePyramid, affine: np.ndarray) -> None:
        """Put a keyframe into the window."""
        self._exposure = keyframe.exposure
        self.keyframes.append(keyframe)
        w = self.window
        w.add(keyframe, pyramid, affine, float(w.outlier[w.newest]) if len(w) else None)
        self.place(keyframe.frame, keyframe.stamp_s, np.eye(4))

    def select(self, pyramid: ImagePyramid, usual: float) -> None:
        """Select points of the newest keyframe, and describe the corners among them if there are loops.

        Args:
            pyramid: of it.
            usual: usual inverse depth.
        """
        w, config = self.window, self.config
        found = select(pyramid, config.selection)
        if self._corner_view is not None:
            level, keyframe = pyramid.levels[0], self.keyframes[-1]
            found, corner = with_corners(found, level, config.corners)
            keyframe.corners = described(
                level, found.xy[corner], keyframe.frame, keyframe.stamp_s, self._camera, self._corner_view
            )
        more = Immature.at(pyramid, w.newest, found.xy.astype(float), found.scale, usual, config.photometric)
        w.immature = w.immature.with_more(more)

    def refer(self, pyramid: ImagePyramid) -> None:
        """Track against the newest keyframe from now on."""
        uv, inverse_depth, information = self.window.seen_from(self.window.newest)
        # Half of a depth's error is its keyframe's, which it shares with others: weights are bounded.
        information = information + _LEAST_WEIGHT
        usual = np.median(information) if len(information) else 1.0
        weight = 1.0 / (1.0 / information + 1.0 / usual)
        self._reference = TrackingReference(pyramid, self.intrinsics, uv, inverse_depth, weight)
        self._affine, self._first_error = np.zeros(2), np.nan

    def activate(self) -> None:
        """Activate points of a window of two keyframes, at the start, and adjust it."""
        config = self.config
        activate(self.window, config.photometric)
        adjust(self.window, config.photometric, 3 * config.window.iterations)
        self.window.drop_points(~(self.window.active.seen == 1).any(axis=1))

    def see_through(self, camera: PinholeCamera, rectifier: Rectifier) -> None:
        """Go on with another residual of the lens.

        The window's images are undistorted anew, its points moved in them, and what was marginalised under
        the former lens is forgotten. Keyframes that have left keep their poses.

        Args:
            camera: with the other residual.
            rectifier: of it.
        """
        w, former, photometric = self.window, self._camera, self.config.photometric
        self._camera = camera
        self.lens.changed(camera)

        def moved(uv: np.ndarray) -> np.ndarray:
            taken = distort_residual(uv, former.residual, former.intrinsics)
            return undistort_residual(taken, camera.residual, camera.intrinsics)

        for slot in w.slots:
            image = w.keyframes[slot].image
            assert image is not None
            w.see(slot, rectifier.pyramid(image))
        w.forget_prior()
        w.active = w.active.moved(w.pyramids, moved(w.active.uv), photometric)
        w.immature = w.immature.moved(w.pyramids, moved(w.immature.uv), photometric)
        for keyframe in self.keyframes:
            keyframe.uv = moved(keyframe.uv)
            if keyframe.corners is not None:
                keyframe.corners = keyframe.corners.seen_by(camera)
        adjust(w, photometric, 3 * self.config.window.iterations)
        w.drop_points(~(w.active.seen == 1).any(axis=1))
        self.refer(w.pyramids[w.newest])

    # -- what is known -----------------------------------------------------------------------------------

    def forget(self, frame: int) -> None:
        """Forget the pose of a frame that is not tracked after all, and its keyframe if it has become one."""
        self.frames.pop(frame, None)
        if self.keyframes[-1].frame == frame:
            self.keyframes.pop()

    def rows_of(self, slots: list[int]) -> list[int]:
        """Rows of keyframes of the window."""
        row = {id(keyframe): k for k, keyframe in enumerate(self.keyframes)}
        return [row[id(self.window.keyframes[slot])] for slot in slots]

    def move_keyframes(self, S_cam_map: np.ndarray) -> np.ndarray:
        """Move the keyframes that have left the window, with their points and frames.

        Args:
            S_cam_map: (K, 4, 4) similarities; rows of keyframes of the window are not read.

        Returns:
            (K,) scale change of lengths around each keyframe.
        """
        factor, held = np.ones(len(self.keyframes)), set(self.rows_of(self.window.slots))
        for row, keyframe in enumerate(self.keyframes):
            if row in held:
                continue
            s, R, t = sim3_decompose(S_cam_map[row])
            keyframe.T_cam_map[:3, :3], keyframe.T_cam_map[:3, 3] = R, t / s
            keyframe.inverse_depth = keyframe.inverse_depth * s
            factor[row] = 1.0 / s
        for frame, placed in self.frames.items():
            T = placed.T_cam_keyframe.copy()
            T[:3, 3] *= factor[placed.keyframe]
            self.frames[frame] = replace(placed, T_cam_keyframe=T)
        return factor

    def close(self) -> None:
        """End the map: its images are not needed any more."""
        self.window.keep_points(np.ones(len(self.window.active), bool))
        for keyframe in self.window.keyframes.values():
            keyframe.image = None
        self.window = Window(self._camera, self.intrinsics, self.config.window)
        self._reference = None

    def pixels(self, frame: int) -> np.ndarray:
        """(N, 2) pixels of the ideal camera at which a placed frame shows some of the keyframe's points."""
        if self._reference is None:
            return np.empty((0, 2))
        uv = self._reference.patches.seen_by(self.intrinsics[0], self.frames[frame].T_cam_keyframe)
        return uv[((uv >= 0) & (uv < [self._camera.width_px, self._camera.height_px])).all(axis=1)]

    def residuals(self, frame: int, pyramid: ImagePyramid) -> tuple[np.ndarray, np.ndarray]:
        """(N, 2) ideal pixels and (N,) residuals of the newest frame against the newest keyframe."""
        if self._reference is None:
            return np.empty((0, 2)), np.empty(0)
        return self._reference.residuals(pyramid, self.frames[frame].T_cam_keyframe, self._affine)

    def trajectory(self, map_id: int) -> MapTrajectory:
        """Poses of the frames, by their keyframes as they are now."""
        order = sorted(self.frames)
        poses = np.linalg.inv(np.array([self.pose(k) for k in order]).reshape(-1, 4, 4))
        return MapTrajectory(
            map_id, np.array(order, int), np.array([self.frames[k].stamp_s for k in order]), poses
        )

    def keyframe_trajectory(self, map_id: int) -> MapTrajectory:
        """Poses of the keyframes."""
        poses = np.linalg.inv(np.array([k.T_cam_map for k in self.keyframes]).reshape(-1, 4, 4))
        return MapTrajectory(
            map_id, np.array([k.frame for k in self.keyframes], int),
            np.array([k.stamp_s for k in self.keyframes]), poses,
        )  # fmt: skip

    def points(self) -> np.ndarray:
        """(N, 3) points that were ever part of the window, in the map."""
        gone = [k.map_points(self.intrinsics[0]) for k in self.keyframes]
        return np.concatenate([*gone, self.window.map_points()]).reshape(-1, 3)
