"""ORB-SLAM's rules of tracking as they were published.

The numbers are those of the text where it gives them. Where it says "enough" or "not enough", they are those
that its public release is known by, as published descriptions of it give them; each says so.

Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM: a versatile and accurate monocular SLAM system", IEEE Trans.
Robotics 31(5), 2015, section V.
"""

import numpy as np

from dslab.slam.association.placing import NOTHING, Sighted
from dslab.slam.core._frame_kernels import median_depth
from dslab.slam.core.frame import Frame
from dslab.slam.map._map_kernels import count_observed
from dslab.slam.map.map import Map
from dslab.slam.optimization.pose import optimize_pose
from dslab.slam.published._search_kernels import search_last_frame, search_local_map
from dslab.slam.tracking.rules.interface import Gate, KeyframeChoice, Loss, Search, Tracking
from dslab.slam.tracking.rules.reference import track_reference_keyframe

# Windows around a predicted point, px on level 0, and in the local map; twice in the wider search: release.
_RADIUS_PX, _LOCAL_RADIUS_PX = 15.0, 4.0
# Fewest matches with the last frame, of them that survive, and with the reference keyframe: release.
_MATCHES, _INLIERS, _REFERENCE_MATCHES = 20, 10, 15
# Fewest inliers of a tracked frame; more in the first second after a relocalization: release.
_LEAST_INLIERS, _LEAST_INLIERS_RESUMED, _RESUMED_S = 30, 50, 1.0
_FRAMES_APART = 20  # "more than 20 frames": section V-E, conditions 1 and 2
_KEYFRAME_POINTS, _KEYFRAME_SHARE = 50, 0.9  # section V-E, conditions 3 and 4
# Time in which mapping is busy with a keyframe: Table III, median of local mapping. In lockstep mapping takes
# no time here, and nearly every frame would become a keyframe.
_MAPPING_S = 0.384


class PublishedSearch(Search):
    """Section V-B: the motion model, else a wider search around the last positions; V-D: the local map."""

    def predict(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        """Find a first pose by the motion model, by a wider search, or by the reference keyframe."""
        starts = [(last.T_cam_map, 2.0 * _RADIUS_PX)]
        if tracking.velocity is not None:
            starts.insert(0, (tracking.velocity @ last.T_cam_map, _RADIUS_PX))
        for T_cam_map, radius_px in starts:
            start = np.ascontiguousarray(T_cam_map)
            if _match_last(tracking, frame, last, start, radius_px) >= _MATCHES:
                frame.T_cam_map = start.copy()
                if _GATE.refine(tracking.map, frame)[0] >= _INLIERS:
                    return True
                break
        return track_reference_keyframe(tracking, _GATE, frame, last, _REFERENCE_MATCHES, _INLIERS)

    def seek(self, map_: Map, frame: Frame, points: np.ndarray, observing: bool) -> None:
        """Match the still unmatched keypoints of a frame."""
        f = frame.features
        search_local_map(
            map_.arrays, map_.view, frame.T_cam_map, points, f.xy, f.octave, f.descriptors, f.cell_start,
            frame.point, _LOCAL_RADIUS_PX, observing,
        )  # fmt: skip


def _match_last(
    tracking: Tracking, frame: Frame, last: Frame, T_cam_map: np.ndarray, radius_px: float
) -> int:
    """Match a frame with the last one's points around a pose; number of matches."""
    m, f = tracking.map, frame.features
    frame.point = search_last_frame(
        m.arrays, m.view, T_cam_map, last.point, last.features.octave, f.xy, f.octave, f.descriptors,
        f.cell_start, radius_px,
    )  # fmt: skip
    return int((frame.point >= 0).sum())


class PublishedGate(Gate):
    """χ² at 95 % over one noise per pyramid level: 1 px on the finest, "in the measurement error" of IV-2."""

    def refine(self, map_: Map, frame: Frame, also: Sighted = NOTHING) -> tuple[int, np.ndarray]:
        """Refine a frame's pose at the map's noise."""
        f, view = frame.features, map_.view
        rows = np.flatnonzero(frame.point >= 0)
        frame.T_cam_map, inlier, _ = optimize_pose(
            frame.T_cam_map,
            np.concatenate([map_.arrays.pt_xyz[frame.point[rows]], also.xyz]),
            np.concatenate([f.xy[rows], also.pixels]),
            np.concatenate([view.inv_sigma2[f.octave[rows]], also.inv_sigma2]),
            view.fx, view.fy, view.cx, view.cy,
        )  # fmt: skip
        own = inlier[: len(rows)]
        frame.depth = median_depth(map_.arrays.pt_xyz[frame.point[rows[own]]], frame.T_cam_map)
        frame.point[rows[~own]] = -1
        return int(own.sum()), inlier[len(rows) :]


_GATE = PublishedGate()


class PublishedLoss(Loss):
    """A count of inliers, higher for a second after a relocalization."""

    least_inliers = _LEAST_INLIERS

    def fault(self, tracking: Tracking, frame: Frame, last: Frame, inliers: int) -> str:
        """Why a frame counts as lost."""
        resumed = tracking.resumed
        lately = resumed is not None and abs(frame.features.stamp_s - resumed.stamp_s) < _RESUMED_S - 1e-6
        least = _LEAST_INLIERS_RESUMED if lately else _LEAST_INLIERS
        return "too_few_local_map_inliers" if inliers < least else ""


class PublishedKeyframeChoice(KeyframeChoice):
    """Section V-E: four conditions, all of which must hold."""

    def may(self, tracking: Tracking, frame: Frame, mapping_is_idle: bool) -> bool:
        """Conditions 1 and 2: far from a relocalization; mapping idle, or far from the last keyframe."""
        now, last, resumed = frame.features.index, tracking.last_keyframe, tracking.resumed
        if resumed is not None and abs(now - resumed.index) <= _FRAMES_APART:
            return False
        if last is None or abs(now - last.index) > _FRAMES_APART:
            return True
        begun = tracking.map.n_keyframes > 2  # the two of the start are adjusted by tracking: IV-5
        waited = abs(frame.features.stamp_s - last.stamp_s) >= _MAPPING_S
        return mapping_is_idle and (waited or not begun)

    def wants(self, tracking: Tracking, frame: Frame, inliers: int, mapping_is_idle: bool) -> bool:
        """Return True if all four hold."""
        if not self.may(tracking, frame, mapping_is_idle):
            return False
        known = count_observed(tracking.map.arrays, frame.reference_keyframe, 1)
        return inliers >= _KEYFRAME_POINTS and inliers < _KEYFRAME_SHARE * known
