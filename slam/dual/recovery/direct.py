"""Recovery by intensities: frames placed by photometric alignment, backward.

Where corners blur or vanish, intensities may still tell. A frame is aligned with the last placed one on pixels of
known depth; these are then located in it one by one, across their edges, and go on as tracks, which are
triangulated, take part in bundle adjustment and carry the depth to new surface. The map grows with ORB
features on these poses.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018; Forster, Pizzoli, Scaramuzza, "SVO", 2014.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

from slam.core.frame import Frame
from slam.core.geometry import share_of_motion
from slam.direct._alignment_kernels import PATTERN, sample_patterns
from slam.direct._location_kernels import locate, search_line
from slam.direct.alignment import Aligned, AlignmentConfig, Reference, align, fan
from slam.direct.pyramid import ImagePyramid, Rectifier
from slam.direct.selection import SelectionConfig, select
from slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from slam.dual.recovery.propagation import propagate
from slam.dual.recovery.sift import SiftRecoveryConfig, SiftTracker
from slam.dual.recovery.sift_mapping import SiftMapper
from slam.features.sift import SiftFrame, take_depth_from_points
from slam.map._map_kernels import resolve_points
from slam.tracking.tracker import Tracker, TrackingOutcome


@dataclass(frozen=True)
class DirectRecoveryConfig(SiftRecoveryConfig):
    """Settings of the direct thread."""

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    selection: SelectionConfig = field(default_factory=lambda: SelectionConfig(points=1500))
    most_error: float = 9.0
    least_visible: float = 0.25
    most_saturated: float = 0.25
    point_error: float = 12.0
    distinct: float = 1.6
    line_px: float = 60.0
    min_sift_inliers_alone: int = 60
    depth_radius_px: float = 10.0


class DirectRecovery:
    """Recovery that places frames by intensities and maps ORB features."""

    name = "direct"
    needs_images = True
    cost = RecoveryCost(frame_ms=20.0, keyframe_ms=50.0, alignment_ms=4.0)

    def __init__(self, config: RecoveryConfig | None = None) -> None:
        self.config = DirectRecoveryConfig.extending(config)

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Place the buffered frames newest first, each by photometric alignment with the last one."""
        tracker = DirectTracker(task, self.config)
        mapper = SiftMapper(
            task.new_map,
            self.config.mapping_in(task),
            tracker.last_sift,
            lambda: tracker.last_sift,
            self.config.adjusted_keyframes,
            self.config.paired_keyframes,
        )
        return propagate(task, self.config, tracker, mapper)


DEBUG = False


class DirectTracker(SiftTracker):
    def __init__(self, task, config):
        self._rectifier = Rectifier(task.camera)
        self._pyramids: dict[int, ImagePyramid] = {}
        self._direct = config
        self._step = task.step
        self._missed = 0
        self.log = []
        self.errors = []
        super().__init__(task, config)

    def _pyramid(self, frame: Frame) -> ImagePyramid:
        index = frame.features.index
        if index not in self._pyramids:
            keep = {self.last_sift.frame.features.index, self._keyframe_sift.frame.features.index} if hasattr(self, "_keyframe_sift") else set()
            self._pyramids = {k: v for k, v in self._pyramids.items() if k in keep}
            self._pyramids[index] = self._rectifier.pyramid(self._task.image_of(index))
        return self._pyramids[index]

    def _detect(self, frame):
        return self._with_new(frame, np.empty((0, 2)), np.empty(0))

    def _with_new(self, frame, xy, sigma):
        found = select(self._pyramid(frame), self._direct.selection)
        new = found.xy.astype(float)
        if len(xy):
            cell = 8.0
            taken = set(map(tuple, np.floor(xy / cell).astype(int)))
            keep = np.array([tuple(c) not in taken for c in np.floor(new / cell).astype(int)], bool)
            room = max(0, self._direct.selection.points - len(xy))
            rows = np.flatnonzero(keep)
            if len(rows) > room:
                rows = rows[np.arange(room) * len(rows) // max(1, room)]
            new, scale = new[rows], found.scale[rows]
        else:
            scale = found.scale
        allxy = np.concatenate([xy, new])
        inv = np.concatenate([1 / sigma**2, 0.25**scale])
        return SiftFrame(frame, allxy, inv, np.empty((len(allxy), 0), np.uint8))

    def track(self, frame: Frame) -> TrackingOutcome:
        outcome = self._place_directly(frame, self.last_sift)
        if not outcome.success and self._keyframe_sift is not self.last_sift:
            again = self._place_directly(frame, self._keyframe_sift)
            outcome = again if again.success else outcome
        return outcome

    def pass_over(self, frame: Frame) -> None:
        self._passed_over += 1

    def _place_directly(self, frame: Frame, reference: SiftFrame) -> TrackingOutcome:
        config, m = self._direct, self.map
        rows = np.flatnonzero(reference.known & (np.nan_to_num(reference.xyz_cam[:, 2]) > 0))
        if len(rows) < config.min_sift_inliers:
            return TrackingOutcome(False, 0, len(rows), "too_few_points_of_known_depth")
        pyramid, intrinsics = self._pyramid(frame), self._rectifier.intrinsics
        ref = Reference(self._pyramid(reference.frame), intrinsics, reference.xy[rows], 1 / reference.xyz_cam[rows, 2], config.alignment)
        T_ref = self._pose_of(reference.frame)
        gap = abs(reference.frame.features.index - frame.features.index)
        velocity = self.velocity if self.velocity is not None else self._step
        ahead = np.linalg.matrix_power(velocity, min(gap, 90))
        guesses = [*fan(ahead, intrinsics), velocity, np.eye(4)]
        shares = (0.8, 1.25, 0.65, 1.5) if gap > 3 else ()
        guesses += [np.linalg.matrix_power(velocity, max(1, round(gap * x))) for x in shares]
        found = align(ref, pyramid, guesses)
        blurred = False
        typical = float(np.median(self.errors)) if self.errors else 4.0
        bar = config.most_error
        if found is None or found.error > bar or found.saturated > config.most_saturated:
            again = self._align_blurred(frame, reference, ref, rows, guesses, velocity)
            if again is not None and again.error <= min(8.0, 0.65 * (found.error if found else 14.0)):
                found, blurred = again, True
        if found is None:
            return TrackingOutcome(False, 0, 0, "no_alignment")
        if DEBUG: print("      ", frame.features.index, gap, "err %.1f vis %.2f sat %.2f n %d" % (found.error, found.visible, found.saturated, len(rows)))
        self.log.append((frame.features.index, found.error, found.visible, found.saturated, len(rows)))
        if found.visible < config.least_visible:
            return TrackingOutcome(False, 0, 0, "too_little_in_view")
        if not blurred and (found.error > bar or found.saturated > config.most_saturated):
            return TrackingOutcome(False, 0, 0, "images_differ")
        if not blurred:
            self.errors.append(found.error)
        if blurred:
            return self._accept_blurred(frame, reference, rows, found, T_ref, gap)
        p = ref.levels[0]
        xy, error = np.empty_like(p.uv), np.empty(len(p.uv))
        locate(pyramid.levels[0], intrinsics[0], p.uv, p.inverse_depth, PATTERN, p.intensity, p.weight, found.T_target_ref, found.affine, xy, error)
        seen = np.isfinite(xy[:, 0]) & (error < config.point_error)
        known_rows, known_xy = rows[seen], xy[seen]
        if len(known_rows) < config.min_sift_inliers:
            return TrackingOutcome(False, 0, len(known_rows), "too_few_points_located")
        other_rows, other_xy = self._on_lines(reference, rows, pyramid, found)
        pairs_ref = np.concatenate([known_rows, other_rows])
        sigma = 1 / np.sqrt(reference.inv_sigma2[pairs_ref])
        sift = self._with_new(frame, np.concatenate([known_xy, other_xy]), sigma)
        frame.T_cam_map = np.ascontiguousarray(found.T_target_ref @ T_ref)
        xyz = reference.positions(known_rows, T_ref)
        resolve_points(m.arrays, reference.frame.point)
        agree, points, matches = self._match_map(sift, reference.frame.point, xyz, np.arange(len(known_rows)))
        inliers = int(agree.sum())
        alone = points < config.min_points
        if inliers + points < self._least_inliers(frame, 0) or inliers < (config.min_sift_inliers_alone if alone else config.min_sift_inliers):
            return TrackingOutcome(False, points, matches, "too_few_inliers")
        fault = self._fault_of_crossing(frame, reference.frame)
        if fault:
            return TrackingOutcome(False, points, matches, fault)
        if alone:
            frame.point[:] = -1
        self._set_reference(frame, reference.frame)
        self._accept(frame, reference.frame)
        if gap > 1 and self.velocity is not None:
            self.velocity = share_of_motion(self.velocity, 1.0 / gap)
        good = np.concatenate([agree, np.ones(len(other_rows), bool)])
        own = np.flatnonzero(good)
        self._pass_tracks_on(sift, reference, np.column_stack([pairs_ref[good], own]))
        self._register(sift)
        return TrackingOutcome(True, points, matches)

    def _align_blurred(self, frame, reference, ref, rows, guesses, velocity):
        """Alignment with the sharper of the two images blurred along the motion; None for none."""
        config, intrinsics = self._direct, self._rectifier.intrinsics
        target, source = self._pyramid(frame), self._pyramid(reference.frame)
        fx, fy, cx, cy = intrinsics[0]
        xyz = reference.xyz_cam[rows]
        moved = xyz @ velocity[:3, :3].T + velocity[:3, 3]
        ok = moved[:, 2] > 0
        if not ok.any():
            return None
        before = xyz[ok, :2] / xyz[ok, 2:] * [fx, fy]
        flow = np.median(moved[ok, :2] / moved[ok, 2:] * [fx, fy] - before, axis=0)
        speed = float(np.linalg.norm(flow))
        if speed < 1.0:
            return None
        best = None
        sharper_target = _sharpness(target) > _sharpness(source)
        for factor in (0.7, 1.4, 2.5, 4.0, 6.0, 9.0, 13.0):
            length = factor * speed
            if length < 3 or length > 0.4 * target.levels[0].shape[1]:
                continue
            if sharper_target:
                found = align(ref, self._blurred(target, flow / speed, length), guesses, finest=1)
            else:
                other = Reference(self._blurred(source, flow / speed, length), intrinsics, reference.xy[rows], 1 / xyz[:, 2], config.alignment)
                found = align(other, target, guesses, finest=1)
            if found is not None and DEBUG:
                print("        blur", sharper_target, round(length), "err %.1f vis %.2f sat %.2f" % (found.error, found.visible, found.saturated))
            if found is not None and found.visible > config.least_visible and (best is None or found.error < best.error):
                best = found
        return best

    def _blurred(self, pyramid, direction, length):
        image = pyramid.levels[0][..., 0]
        n = int(length) | 1
        kernel = np.zeros((n, n), np.float32)
        c = n // 2
        a = (c - direction * c, c + direction * c)
        cv2.line(kernel, tuple(np.round(a[0]).astype(int)), tuple(np.round(a[1]).astype(int)), 1.0, 1)
        out = cv2.filter2D(np.nan_to_num(image), -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
        return self._rectifier.pyramid_of(out)

    def _accept_blurred(self, frame, reference, rows, found, T_ref, gap):
        m = self.map
        sift = self._with_new(frame, np.empty((0, 2)), np.empty(0))
        frame.T_cam_map = np.ascontiguousarray(found.T_target_ref @ T_ref)
        xyz = reference.xyz_cam[rows] @ found.T_target_ref[:3, :3].T + found.T_target_ref[:3, 3]
        fx, fy, cx, cy = self._rectifier.intrinsics[0]
        xyz = xyz[xyz[:, 2] > 0]
        uv = xyz[:, :2] / xyz[:, 2:] * [fx, fy] + [cx, cy]
        world = (xyz - frame.T_cam_map[:3, 3]) @ frame.T_cam_map[:3, :3]
        take_depth_from_points(sift, world, uv, frame.T_cam_map, m.view, 2 * self._direct.depth_radius_px)
        resolve_points(m.arrays, reference.frame.point)
        frame.point[:] = -1
        self._set_reference(frame, reference.frame)
        self._accept(frame, reference.frame)
        if gap > 1 and self.velocity is not None:
            self.velocity = share_of_motion(self.velocity, 1.0 / gap)
        self._register(sift)
        return TrackingOutcome(True, 0, int(sift.known.sum()))

    def _on_lines(self, reference: SiftFrame, known, pyramid, found: Aligned):
        config, intrinsics = self._direct, self._rectifier.intrinsics
        rows = np.setdiff1d(np.arange(len(reference.xy)), known)
        if not len(rows):
            return rows, np.empty((0, 2))
        uv = np.ascontiguousarray(reference.xy[rows])
        intensity, weight = np.empty((len(rows), 8)), np.empty((len(rows), 8))
        sample_patterns(self._pyramid(reference.frame).levels[0], uv, PATTERN, 50.0, intensity, weight)
        depth = reference.depth
        xy, error = np.empty_like(uv), np.empty(len(uv))
        search_line(pyramid.levels[0], intrinsics[0], uv, PATTERN, intensity, weight, found.T_target_ref, found.affine,
                    4.0 / depth, 0.05 / depth, config.line_px, config.point_error, config.distinct, xy, error)
        ok = np.isfinite(xy[:, 0])
        return rows[ok], xy[ok]


def _sharpness(pyramid):
    return float(np.nanmean(np.abs(pyramid.levels[0][..., 1:])))
