"""Recovery by intensities: frames placed by photometric alignment, backward.

Where corners blur or vanish, intensities may still tell. A frame is aligned with the last placed one on
pixels of known depth. These are then located in it one by one, across their edges, and go on as tracks,
which are triangulated, take part in bundle adjustment and carry the depth to new surface. The map grows with
ORB features on these poses.

Where one of two frames is blurred by motion and the other is not, the sharper one is blurred along the
predicted motion before they are compared, by the length under which they look most alike.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018; Forster, Pizzoli, Scaramuzza, "SVO: Fast
Semi-Direct Monocular Visual Odometry", 2014.
"""

from dataclasses import dataclass, field

import numpy as np

from slam.core.frame import Frame
from slam.core.geometry import share_of_motion
from slam.direct.alignment import Aligned, AlignmentConfig, Reference, align, fan
from slam.direct.blur import align_through_blur, sharpness
from slam.direct.location import locate_on_lines, locate_points
from slam.direct.pyramid import ImagePyramid, Rectifier
from slam.direct.selection import SelectionConfig, select
from slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from slam.dual.recovery.propagation import propagate
from slam.dual.recovery.tracks import TrackRecoveryConfig, TrackTracker
from slam.features.tracks import TrackedFrame, take_depth_from_points
from slam.tracking.tracker import TrackingOutcome

_CELL_PX = 8  # in which a located point leaves no room for a new one
_SPEEDS = (0.65, 0.8, 1.25, 1.5)  # of the predicted motion over a gap that are tried too
_LONG_GAP = 3
_MOST_SPREAD_CHANGE = 4.0
_BLURRED = 0.6  # of the sharpness of the sharpest image


@dataclass(frozen=True)
class DirectRecoveryConfig(TrackRecoveryConfig):
    """Settings of the direct thread.

    Attributes:
        alignment, selection: of photometric alignment, and of the points that it rests on.
        most_error: error of an alignment, of 255, beyond which the images differ.
        most_saturated: share of its pixels beyond the cutoff, likewise.
        least_likeness: correlation of the views within the patterns, below which they differ too.
        least_visible: share of the reference's points that must be in view.
        through_blur: compare a sharp image with a blurred one by blurring it.
        blurred_error: as ``most_error``, for such a comparison.
        blurred_share: least gain by it: its error over that of the images as they are.
        point_error: mean absolute residual beyond which a point is not located.
        distinct: residual of the second best place on an epipolar line over the best, at least.
        line_px: longest line that is searched.
    """

    depth_radius_px: float = 10.0
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    selection: SelectionConfig = field(default_factory=lambda: SelectionConfig(points=1500))
    most_error: float = 9.0
    most_saturated: float = 0.25
    least_likeness: float = 0.5
    least_visible: float = 0.25
    through_blur: bool = True
    blurred_error: float = 8.0
    blurred_share: float = 0.65
    point_error: float = 12.0
    distinct: float = 1.6
    line_px: float = 60.0


class DirectRecovery:
    """Recovery that places frames by intensities and maps ORB features."""

    name = "direct"
    needs_images = True
    # Measured: CPU on one core, 640x480, 1,500 points, 1,000 ORB features.
    cost = RecoveryCost(frame_ms=35.0, keyframe_ms=50.0, alignment_ms=4.0)

    def __init__(self, config: RecoveryConfig | None = None) -> None:
        self.config = DirectRecoveryConfig.extending(config)

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Place the buffered frames newest first, each by photometric alignment with the last one."""
        rectifier = Rectifier(task.camera)
        if rectifier.is_too_small:
            return RecoveryResult(task.new_map, stage="propagation", reason="image_too_small")
        tracker = DirectTracker(task, self.config, rectifier)
        return propagate(task, self.config, tracker, tracker.mapper(task))


@dataclass
class DirectFrame(TrackedFrame):
    """Points of a frame with its image.

    Attributes:
        pyramid: of the image.
    """

    pyramid: ImagePyramid


class DirectTracker(TrackTracker):
    """Places frames by photometric alignment."""

    latest: DirectFrame
    keyframe_view: DirectFrame

    def __init__(self, task: RecoveryTask, config: DirectRecoveryConfig, rectifier: Rectifier) -> None:
        self._direct_config = config
        self._task = task
        self._rectifier = rectifier
        nothing = np.empty((0, 2)), np.empty(0)
        super().__init__(task, config, self._with_new_points(task.first, self._pyramid(task.first), *nothing))
        self.velocity = task.step
        self._sharpest = sharpness(self.latest.pyramid)

    def wants_keyframe(self, frame: Frame, inliers: int) -> bool:
        """Decide as for other features, but never in a blurred image, whose corners are not the scene's.

        Triangulated between such images, they took the map to another scale.
        """
        sharp = sharpness(self.latest.pyramid)
        self._sharpest = max(self._sharpest, sharp)
        blurred = sharp < _BLURRED * self._sharpest
        return not blurred and super().wants_keyframe(frame, inliers)

    def track(self, frame: Frame) -> TrackingOutcome:
        """Place the frame by alignment with the last placed frame or the last keyframe.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        pyramid = self._pyramid(frame)
        outcome = self._place(frame, pyramid, self.latest)
        again = self._direct_config.keyframe_too and self.keyframe_view is not self.latest
        if not outcome.success and again:
            outcome = self._place(frame, pyramid, self.keyframe_view)
        return outcome

    # -- steps -------------------------------------------------------------------------------------------

    def _pyramid(self, frame: Frame) -> ImagePyramid:
        return self._rectifier.pyramid(self._task.image_of(frame.features.index))

    def _with_new_points(
        self, frame: Frame, pyramid: ImagePyramid, xy: np.ndarray, inv_sigma2: np.ndarray
    ) -> DirectFrame:
        """The frame with points located in it (k, 2) and new ones where these leave room."""
        found = select(pyramid, self._direct_config.selection)
        taken = _cells(xy)
        free = np.flatnonzero(~np.isin(_cells(found.xy), taken))
        room = max(0, self._direct_config.selection.points - len(xy))
        if len(free) > room:
            free = free[np.arange(room) * len(free) // max(1, room)]
        return DirectFrame(
            frame,
            np.concatenate([xy, found.xy[free].astype(float)]),
            np.concatenate([inv_sigma2, 0.25 ** found.scale[free]]),
            pyramid,
        )

    def _place(self, frame: Frame, pyramid: ImagePyramid, reference: DirectFrame) -> TrackingOutcome:
        config, intrinsics = self._direct_config, self._rectifier.intrinsics
        rows = np.flatnonzero(reference.known & ~(reference.xyz_cam[:, 2] <= 0))
        if len(rows) < config.min_features:
            return TrackingOutcome(False, 0, len(rows), "too_few_points_of_known_depth")
        xyz = reference.xyz_cam[rows]
        view = Reference(reference.pyramid, intrinsics, reference.xy[rows], 1 / xyz[:, 2], config.alignment)
        gap = abs(reference.frame.features.index - frame.features.index)
        found = align(view, pyramid, self._guesses(gap))
        sharp = found is not None and self._look_alike(found)
        if not sharp:
            found = self._through_blur(view, reference, pyramid, rows, gap, found)
        if found is None:
            return TrackingOutcome(False, 0, len(rows), "images_differ")
        if found.visible < config.least_visible or not _keeps_spread(xyz, found.T_target_ref):
            return TrackingOutcome(False, 0, len(rows), "too_little_in_view")
        frame.T_cam_map = np.ascontiguousarray(found.T_target_ref @ self.pose_of(reference.frame))
        follow = self._follow_points if sharp else self._carry_depths
        outcome = follow(frame, pyramid, reference, rows, view, found)
        if outcome.success:
            moved = frame.T_cam_map @ np.linalg.inv(self.pose_of(reference.frame))
            self.velocity = share_of_motion(moved, 1 / gap)
        return outcome

    def _guesses(self, gap: int) -> list[np.ndarray]:
        """Motions over so many frames that are tried."""
        velocity = self.velocity if self.velocity is not None else np.eye(4)
        steps = [gap] + [max(1, round(gap * speed)) for speed in _SPEEDS if gap > _LONG_GAP]
        ahead = [np.linalg.matrix_power(velocity, step) for step in steps]
        return [*fan(ahead[0], self._rectifier.intrinsics), *ahead[1:], np.eye(4)]

    def _look_alike(self, found: Aligned) -> bool:
        config = self._direct_config
        return (
            found.error <= config.most_error
            and found.saturated <= config.most_saturated
            and found.likeness >= config.least_likeness
        )

    def _through_blur(
        self,
        view: Reference,
        reference: DirectFrame,
        pyramid: ImagePyramid,
        rows: np.ndarray,
        gap: int,
        sharp: Aligned | None,
    ) -> Aligned | None:
        """The alignment with the sharper image blurred along the motion; None where this explains little."""
        config = self._direct_config
        if not config.through_blur or self.velocity is None:
            return None
        found = align_through_blur(
            view, reference.pyramid, pyramid, self._rectifier, reference.xyz_cam[rows], self.velocity,
            self._guesses(gap),
        )  # fmt: skip
        if found is None or (sharp is not None and found.error > config.blurred_share * sharp.error):
            return None
        alike = found.likeness >= config.least_likeness
        return found if alike and found.error <= config.blurred_error else None

    def _follow_points(
        self,
        frame: Frame,
        pyramid: ImagePyramid,
        reference: DirectFrame,
        rows: np.ndarray,
        view: Reference,
        found: Aligned,
    ) -> TrackingOutcome:
        """Locate the reference's points in an aligned frame and go on with them."""
        config, intrinsics = self._direct_config, self._rectifier.intrinsics[0]
        xy, error = locate_points(view, pyramid, found)
        seen = np.isfinite(xy[:, 0]) & (error <= config.point_error)
        others = np.setdiff1d(np.arange(len(reference.xy)), rows)
        other_xy = locate_on_lines(
            reference.pyramid, pyramid, intrinsics, reference.xy[others], found, reference.depth,
            config.line_px, config.point_error, config.distinct,
        )  # fmt: skip
        on_line = np.isfinite(other_xy[:, 0])
        theirs = np.concatenate([rows[seen], others[on_line]])
        tracked = self._with_new_points(
            frame, pyramid, np.concatenate([xy[seen], other_xy[on_line]]), reference.inv_sigma2[theirs]
        )
        xyz = reference.positions(rows[seen], self.pose_of(reference.frame))
        outcome, agree = self.confirm(tracked, reference, xyz, np.arange(len(xyz)))
        if outcome.success:
            own = np.flatnonzero(np.concatenate([agree, np.ones(int(on_line.sum()), np.bool_)]))
            self.pass_tracks_on(tracked, reference, np.column_stack([theirs[own], own]))
            self.register(tracked)
        return outcome

    def _carry_depths(
        self,
        frame: Frame,
        pyramid: ImagePyramid,
        reference: DirectFrame,
        rows: np.ndarray,
        view: Reference,
        found: Aligned,
    ) -> TrackingOutcome:
        """Begin anew in a frame aligned through blur: points are not found again, their depths are."""
        nothing = np.empty((0, 2)), np.empty(0)
        tracked = self._with_new_points(frame, pyramid, *nothing)
        xyz = reference.positions(rows, self.pose_of(reference.frame))
        T, map_view = frame.T_cam_map, self.map.view
        in_camera = xyz @ T[:3, :3].T + T[:3, 3]
        ahead = in_camera[:, 2] > 0
        pixels = in_camera[ahead, :2] / in_camera[ahead, 2:] * (map_view.fx, map_view.fy)
        pixels += (map_view.cx, map_view.cy)
        radius_px = 2 * self._direct_config.depth_radius_px
        take_depth_from_points(tracked, xyz[ahead], pixels, T, map_view, radius_px)
        known = int(tracked.known.sum())
        if known < self._direct_config.min_features_alone:
            return TrackingOutcome(False, 0, known, "too_few_points_of_known_depth")
        frame.point[:] = -1
        self.set_reference(frame, reference.frame)
        self._accept(frame, reference.frame)
        self.register(tracked)
        return TrackingOutcome(True, 0, known)


def _cells(xy: np.ndarray) -> np.ndarray:
    """(n,) names of the small squares in which pixels (n, 2) lie."""
    column, row = np.floor(xy.T / _CELL_PX).astype(np.int64)
    return row << 32 | column


def _keeps_spread(xyz: np.ndarray, T_target_ref: np.ndarray) -> bool:
    """False if points (n, 3) of the reference shrink to a patch in the target, which fits many."""
    moved = xyz @ T_target_ref[:3, :3].T + T_target_ref[:3, 3]
    ahead = moved[:, 2] > 0
    if ahead.sum() < len(xyz) / 2:
        return False
    areas = [float(np.prod(np.std(p[ahead, :2] / p[ahead, 2:], axis=0))) for p in (xyz, moved)]
    return areas[0] <= _MOST_SPREAD_CHANGE * areas[1]
