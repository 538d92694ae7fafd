"""Invariants of direct sparse odometry between two frames and their check."""

from itertools import pairwise

import numpy as np

from dslab.slam.core.events import TrackingState
from dslab.slam.ldso.odometry import Odometry
from dslab.slam.ldso.system import DsoSlam
from dslab.slam.ldso.window import PARAMETERS, Window
from dslab.slam.map.invariants import InvariantError, require, require_rigid


def check_direct_maps(system: DsoSlam) -> None:
    """Check the maps of a system: keyframes, frames, windows with their points, what recognises places.

    Raises:
        InvariantError: the first violated invariant.
    """
    current, tracking = system.current_map_id, system.state is TrackingState.TRACKING
    require((current in system._maps) == tracking, f"state {system.state}, but the current map is another")
    require(set(system._closers) <= set(system._maps), "places of a map that does not exist")
    for map_id, odometry in system._maps.items():
        try:
            _check_keyframes(odometry, system.frames)
            _check_frames(odometry)
            _check_window(odometry)
            require(bool(odometry.window.slots) == (map_id == current), "it is closed, or another one is not")
        except InvariantError as error:
            raise InvariantError(f"map {map_id}: {error}") from None


def _check_keyframes(odometry: Odometry, frames: int) -> None:
    keyframes = odometry.keyframes
    require(len(keyframes) > 1, "it has no two keyframes")
    require_rigid(np.array([k.T_cam_map for k in keyframes]), "a keyframe's pose")
    require(all(a.frame < b.frame for a, b in pairwise(keyframes)), "keyframes are out of order")
    require(all(a.stamp_s < b.stamp_s for a, b in pairwise(keyframes)), "keyframes run against time")
    require(all(0 <= k.frame < frames for k in keyframes), "a keyframe of a future frame")
    for k in keyframes:
        require(len(k.uv) == len(k.inverse_depth), "pixels and depths of a keyframe disagree")
        require(np.isfinite(k.uv).all(), "a point of a keyframe is at no pixel")
        require(_is_positive(k.inverse_depth), "a point of a keyframe has no depth")


def _check_frames(odometry: Odometry) -> None:
    placed = [odometry.frames[frame] for frame in sorted(odometry.frames)]
    require({k.frame for k in odometry.keyframes} <= set(odometry.frames), "a keyframe is no placed frame")
    require(all(p.frame == frame for frame, p in odometry.frames.items()), "a frame has another's pose")
    require(all(0 <= p.keyframe < len(odometry.keyframes) for p in placed), "a pose on no keyframe")
    require_rigid(np.array([p.T_cam_keyframe for p in placed]), "the pose of a frame")
    require(all(a.stamp_s < b.stamp_s for a, b in pairwise(placed)), "poses run against time")


def _check_window(odometry: Odometry) -> None:
    window = odometry.window
    slots, live = window.slots, window.live
    require(len(set(slots)) == len(slots) <= window.config.most, "slots are taken twice, or too many")
    require(set(slots) == set(window.keyframes) == set(window.pyramids), "a slot lacks its keyframe or image")
    if slots:
        require_rigid(window.T_first[slots], "the first estimate of a pose")
        require(window.keyframes[window.newest] is odometry.keyframes[-1], "the newest keyframe is another")
    require(all(k in odometry.keyframes for k in window.keyframes.values()), "a keyframe of another map")
    for slot in slots:
        same = np.array_equal(window.T_cam_map[slot], window.keyframes[slot].T_cam_map)
        require(same, "a keyframe and its slot have two poses")
    for name in ("affine", "affine_first", "delta", "prior_H", "prior_b"):
        require(np.isfinite(getattr(window, name)).all(), f"{name} of the window is not finite")
    _check_points(window, live)


def _check_points(window: Window, live: np.ndarray) -> None:
    active, waiting = window.active, window.immature
    require(live[active.host].all() and live[waiting.host].all(), "a point of a keyframe that has left")
    require(_is_positive(active.inverse_depth), "an active point has no depth")
    require((active.seen[:, ~live] == -1).all(), "a residual in a keyframe that has left")
    depths = waiting.inverse_depth, waiting.variance
    require(all((d >= 0).all() for d in depths), "a depth that is searched is none")
    gone = np.repeat(~live, PARAMETERS)
    require(not window.prior_H[gone].any(), "a keyframe that has left is held by what was marginalised")
    uneven, scale = np.abs(window.prior_H - window.prior_H.T).max(), np.abs(window.prior_H).max()
    require(uneven <= 1e-6 * scale, "what was marginalised is not symmetric")


def _is_positive(inverse_depth: np.ndarray) -> bool:
    return bool((np.isfinite(inverse_depth) & (inverse_depth > 0)).all())
