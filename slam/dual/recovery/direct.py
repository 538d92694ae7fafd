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

from dataclasses import dataclass

import numpy as np

from dslab.slam.core.events import CANCELLED
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import share_of_motion
from dslab.slam.core.settings import GREY, setting, settings
from dslab.slam.direct.alignment import Aligned, Reference
from dslab.slam.direct.blur import sharpness
from dslab.slam.direct.location import locate_on_lines, locate_points
from dslab.slam.direct.placement import PlacementConfig, guesses_ahead, place
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.direct.selection import Selection, SelectionConfig, select
from dslab.slam.dual.recovery.appearance import LooksCheck, LooksConfig
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.other_way import OtherWayConfig, objection_of_other_way
from dslab.slam.dual.recovery.propagation import propagate
from dslab.slam.dual.recovery.tracks import TrackRecoveryConfig, TrackTracker
from dslab.slam.features.tracks import TrackedFrame, take_depth_from_points
from dslab.slam.tracking.tracker import TrackingOutcome

_CELL_PX = 8  # in which a located point leaves no room for a new one
_BLURRED = 0.6  # of the sharpness of the sharpest image


@settings
class DirectRecoveryConfig(TrackRecoveryConfig, PlacementConfig):
    """Settings of the direct thread."""

    depth_radius_px: float = setting(
        10.0, "largest distance to a keypoint that gives a point its depth; grows beyond 640 px"
    )
    selection: SelectionConfig = setting(SelectionConfig(points=1500), "of the points aligned")
    point_error: float = setting(12.0, "mean residual beyond which a point is not found", unit=GREY)
    distinct: float = setting(1.6, "least residual of the second best place over the best")
    line_px: float = setting(60.0, "longest epipolar line that is searched")
    looks: LooksConfig = setting(LooksConfig(), "what the old map's surface must look like")
    other_way: OtherWayConfig = setting(OtherWayConfig(), "crossing the gap the other way too, as a check")


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
        looks = LooksCheck(task, rectifier, self.config.looks)
        result = propagate(task, self.config, tracker, tracker.mapper(task), looks.objection)
        if result.success and self.config.other_way.check:
            return self._checked(task, result, rectifier)
        return result

    def _checked(self, task: RecoveryTask, result: RecoveryResult, rectifier: Rectifier) -> RecoveryResult:
        """The result, failed if the gap crossed the other way says something else."""
        config = self.config
        reason = objection_of_other_way(
            task, result, config, config.other_way, lambda ahead: DirectTracker(ahead, config, rectifier)
        )
        if reason:
            cancelled = reason == CANCELLED
            result.success, result.stage = False, CANCELLED if cancelled else "sim3"
            result.reason = "" if cancelled else reason
            result.alignment, result.confirming = None, ()
        return result


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

    def wants_keyframe(self, frame: Frame, inliers: int, mapping_is_idle: bool = True) -> bool:
        """Decide as for other features, but never in a blurred image, whose corners are not the scene's.

        Triangulated between such images, they took the map to another scale.
        """
        sharp = sharpness(self.latest.pyramid)
        self._sharpest = max(self._sharpest, sharp)
        blurred = sharp < _BLURRED * self._sharpest
        return not blurred and super().wants_keyframe(frame, inliers, mapping_is_idle)

    def track(self, frame: Frame) -> TrackingOutcome:
        """Place the frame by alignment with the last placed frame or the last keyframe.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        pyramid = self._pyramid(frame)
        outcome = self._place(frame, pyramid, self.latest)
        if not outcome.success and self.keyframe_view is not self.latest:
            outcome = self._place(frame, pyramid, self.keyframe_view)
        return outcome

    # -- steps -------------------------------------------------------------------------------------------

    def _pyramid(self, frame: Frame) -> ImagePyramid:
        return self._rectifier.pyramid(self._task.image_of(frame.features.index))

    def _with_new_points(
        self, frame: Frame, pyramid: ImagePyramid, xy: np.ndarray, inv_sigma2: np.ndarray
    ) -> DirectFrame:
        """The frame with points located in it (k, 2) and new ones where these leave room."""
        found = self._selected(frame, pyramid)
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

    def _selected(self, frame: Frame, pyramid: ImagePyramid) -> Selection:
        config, camera = self._direct_config.selection, self._task.camera
        return self._task.found_in(frame.features.index, lambda _: select(pyramid, config), (config, camera))

    def _place(self, frame: Frame, pyramid: ImagePyramid, reference: DirectFrame) -> TrackingOutcome:
        config, rectifier = self._direct_config, self._rectifier
        rows = np.flatnonzero(reference.known & ~(reference.xyz_cam[:, 2] <= 0))
        if len(rows) < config.min_features:
            return TrackingOutcome(False, 0, len(rows), "too_few_points_of_known_depth")
        xyz, xy = reference.xyz_cam[rows], reference.xy[rows]
        view = Reference(reference.pyramid, rectifier.intrinsics, xy, 1 / xyz[:, 2], config.alignment)
        gap = abs(reference.frame.features.index - frame.features.index)
        guesses = guesses_ahead(self.velocity, gap)
        placed = place(view, xyz, reference.pyramid, pyramid, rectifier, self.velocity, guesses, config)
        if placed.found is None:
            return TrackingOutcome(False, 0, len(rows), placed.reason)
        frame.T_cam_map = np.ascontiguousarray(placed.found.T_target_ref @ self.pose_of(reference.frame))
        follow = self._follow_points if placed.sharp else self._carry_depths
        outcome = follow(frame, pyramid, reference, rows, view, placed.found)
        if outcome.success:
            moved = frame.T_cam_map @ np.linalg.inv(self.pose_of(reference.frame))
            self.velocity = share_of_motion(moved, 1 / gap)
        return outcome

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
