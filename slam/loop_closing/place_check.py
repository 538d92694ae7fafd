"""Evidence for and against a similarity between two places, from the keyframes on either side."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dslab.slam.belief.log import note
from dslab.slam.belief.model import Unseen
from dslab.slam.core.geometry import camera_centre
from dslab.slam.core.results import MapTrajectory
from dslab.slam.core.settings import setting, settings
from dslab.slam.loop_closing.look_alikes import doubles
from dslab.slam.loop_closing.map_alignment import Agreement, Alignment, Sim3AlignmentConfig, agree, align
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.map.trajectory import keyframe_trajectory
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_inverse
from dslab.slam.places.evidence import EvidenceBar, support
from dslab.slam.tracking.reach import Reach, ReachConfig

_SAME_WAY_DEG = 45.0


@settings
class PlaceCheckConfig:
    """What the keyframes on either side must show for two places to be one."""

    views: int = setting(
        5, "keyframes of a side that look for the other: the aligned one, the most covisible"
    )
    around: int = setting(10, "covisible keyframes whose points are looked for")
    radius_px: float = setting(10.0, "half side of the search window, level 0")
    min_expected: float = setting(20.0, "a view that should see fewer points of the other side says nothing")
    bar: EvidenceBar = setting(EvidenceBar(), "what a view must show")
    far_s: float = setting(2.0, "time between maps beyond which more is asked, as more places are possible")
    far_bar: EvidenceBar = setting(
        EvidenceBar(min_share=0.7, max_contradicted=0.06, min_extent=0.16, max_share=1.6),
        "what a view must show then, of points seen from near it",
    )
    far_share: float = setting(0.5, "time asked of views then, as a share of that between the maps")
    far_max_s: float = setting(6.0, "bound of that time")
    far_sound: float = setting(0.75, "share of the views that must show it then", le=1)
    double_sound: float = setting(0.9, "share asked over far_max_s if a known double is in reach", le=1)
    min_sound: float = setting(0.6, "share of the views of either side that must show it", le=1)
    pairs: int = setting(4, "neighbouring pairs of keyframes that are aligned on their own")
    min_agreeing: float = setting(0.5, "share of the pairs that must give the same similarity", le=1)
    agreement: Agreement = setting(Agreement(), "how near the similarities must be")
    apart: Agreement = setting(
        Agreement(max_scale_change=0.2, max_rotation_deg=10.0, max_shift=0.3),
        "beyond which two similarities are two places",
    )
    alignment: Sim3AlignmentConfig = setting(
        Sim3AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20),
        "thresholds of the pairs",
    )
    reach: ReachConfig = setting(ReachConfig(), "how far the unseen camera can have come")


class _Log(NamedTuple):
    """Of an alignment, for the log: frames of its two ends, and the motion that it supposes."""

    new_frame: int
    old_frame: int
    unseen: Callable[[], Unseen]


def fault_of_alignment(
    old: Map, new: Map, found: Alignment, rng: np.random.Generator, config: PlaceCheckConfig
) -> str:
    """What speaks against an alignment of two maps, or of two ends of one.

    Args:
        old, new: the maps; one and the same for a loop.
        found: the alignment.
        rng: stream of the RANSAC of further alignments.
        config: thresholds.

    Returns:
        ``out_of_reach``, a fault of :class:`EvidenceBar` or ``neighbours_disagree``; empty if nothing does.
    """
    far = False
    if old is not new:
        far = _gap(keyframe_trajectory(old), keyframe_trajectory(new))[0] > config.far_s
        if not within_reach(old, new, found.S_old_new, config.reach):
            return "out_of_reach"
    old_side = _side(old, found.old_keyframe, config.around)
    new_side = _side(new, found.new_keyframe, config.around)
    if old is new:
        new_side = [k for k in new_side if k not in old_side]
    S_new_old = sim3_inverse(found.S_old_new)
    log = _Log(
        new.frame_index(found.new_keyframe), old.frame_index(found.old_keyframe),
        lambda: _unseen(old, new, found, config.reach),
    )  # fmt: skip
    fault = _one_way(new, old, new_side, old_side, S_new_old, config, far, log) or _one_way(
        old, new, old_side, new_side, found.S_old_new, config, far, log
    )
    if fault:
        return fault
    if not _neighbours_agree(old, new, found, old_side, new_side, rng, config):
        return "neighbours_disagree"
    return ""


def double_in_reach(old: Map, new: Map, S_old_new: np.ndarray, config: PlaceCheckConfig) -> bool:
    """Return True if the camera can as well have come to a place that a map knows to look the same."""
    return any(within_reach(old, new, S, config.reach) for S in doubles(old, new, S_old_new))


def asked_span_s(old: Map, new: Map, config: PlaceCheckConfig) -> float:
    """Time over which views must show that two maps are at one place, s; 0 if they are near in time."""
    gap_s, _, _ = _gap(keyframe_trajectory(old), keyframe_trajectory(new))
    return min(config.far_share * gap_s, config.far_max_s) if gap_s > config.far_s else 0.0


def fault_of_view(
    new: Map, keyframe: int, old: Map, newest: Alignment, config: PlaceCheckConfig, first: Alignment
) -> str | None:
    """What the view of one keyframe says against where an alignment puts it in another map, far in time.

    Args:
        new: map of the keyframe.
        keyframe: row.
        old: the other map.
        newest: the alignment.
        config: thresholds.
        first: the one that supposed the place first.

    Returns:
        The fault, empty for none; None if the view says nothing.
    """
    S_cam_old = new.T_cam_map(keyframe) @ sim3_inverse(newest.S_old_new)
    nearest = _nearest(old, S_cam_old)
    if nearest < 0:
        return None
    points = np.unique(np.concatenate([old.observed_points(k) for k in _side(old, nearest, config.around)]))
    points = points[points >= 0].astype(np.int32)
    features = new.features(keyframe)
    seen = support(old, points, S_cam_old, features, config.radius_px, near=True)
    fault = config.far_bar.fault(seen)
    supposed = old.map_id, new.frame_index(first.new_keyframe), old.frame_index(first.old_keyframe)
    note(
        "join", supposed, old, nearest, S_cam_old, features, points, fault,
        lambda: _unseen(old, new, newest, config.reach), _moved(new, keyframe, newest),
    )  # fmt: skip
    return fault if seen.expected >= config.min_expected else None


def _moved(new: Map, keyframe: int, newest: Alignment) -> float:
    """How far a keyframe is from the one that was aligned, lengths of the other map."""
    one, other = (camera_centre(new.T_cam_map(k)) for k in (keyframe, newest.new_keyframe))
    return sim3_decompose(newest.S_old_new)[0] * float(np.linalg.norm(one - other))


def _nearest(map_: Map, S_cam_map: np.ndarray) -> int:
    """The keyframe nearest to a camera of those that look its way; -1 for none."""
    rows = map_.keyframes()
    _, R, _ = sim3_decompose(S_cam_map)
    T = map_.arrays.kf_T_cam_map[rows]
    facing = T[:, 2, :3] @ R[2] > np.cos(np.deg2rad(_SAME_WAY_DEG))
    if not facing.any():
        return -1
    centre = -np.linalg.inv(S_cam_map[:3, :3]) @ S_cam_map[:3, 3]
    centres = -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])
    away = np.linalg.norm(centres - centre, axis=1)
    return int(rows[facing][np.argmin(away[facing])])


def within_reach(old: Map, new: Map, S_old_new: np.ndarray, config: ReachConfig) -> bool:
    """Return True if the camera can have come from one map to the other in the time between them."""
    start, centre, stamp_s = _start(old, new, S_old_new, config)
    return start is None or start.allows(centre, stamp_s)


def _start(
    old: Map, new: Map, S_old_new: np.ndarray, config: ReachConfig
) -> tuple[Reach | None, np.ndarray, float]:
    """Reach from one map towards the other, where they are nearest in time; the other's position and time."""
    before, after = keyframe_trajectory(old), keyframe_trajectory(new)
    after = replace(after, T_map_cam=S_old_new @ after.T_map_cam)
    _, i, j = _gap(before, after)
    reaches = [Reach.of(path, config) for path in (before, after)]
    speeds = [reach.speed for reach in reaches if reach is not None]
    start = None
    if speeds:
        start = Reach(before.T_map_cam[i, :3, 3], float(before.stamps_s[i]), max(speeds), config)
    return start, after.T_map_cam[j, :3, 3], float(after.stamps_s[j])


def _unseen(old: Map, new: Map, found: Alignment, config: ReachConfig) -> Unseen:
    """The motion that an alignment supposes: between two maps, or within one."""
    depth = kernels.median_depth(old.arrays, found.old_keyframe) or np.nan
    if old is new:
        ends_s = [m.features(k).stamp_s for m, k in ((old, found.old_keyframe), (new, found.new_keyframe))]
        path, since_s = keyframe_trajectory(new), ends_s[1] - ends_s[0]
        between = path.T_map_cam[(path.stamps_s >= min(ends_s)) & (path.stamps_s <= max(ends_s)), :3, 3]
        gone = float(np.linalg.norm(np.diff(between, axis=0), axis=1).sum())
        centre = camera_centre(new.T_cam_map(found.new_keyframe))
        moved = found.S_old_new[:3, :3] @ centre + found.S_old_new[:3, 3]
        return Unseen(since_s, gone / depth, float(np.linalg.norm(moved - centre)) / depth)
    start, centre, stamp_s = _start(old, new, found.S_old_new, config)
    if start is None:
        return Unseen(_gap(keyframe_trajectory(old), keyframe_trajectory(new))[0])
    return start.unseen(centre, stamp_s, depth)


def _gap(one: MapTrajectory, other: MapTrajectory) -> tuple[float, int, int]:
    """Least time between two paths, s, and the index in either where it is."""
    gap_s = np.abs(one.stamps_s[:, None] - other.stamps_s[None])
    i, j = np.unravel_index(np.argmin(gap_s), gap_s.shape)
    return float(gap_s[i, j]), int(i), int(j)


def _side(map_: Map, keyframe: int, around: int) -> list[int]:
    """The keyframe, then its most covisible ones."""
    return [keyframe, *(int(k) for k in map_.neighbours(keyframe, around))]


def _one_way(
    here: Map,
    there: Map,
    here_side: list[int],
    there_side: list[int],
    S_here_there: np.ndarray,
    config: PlaceCheckConfig,
    far: bool,
    log: _Log,
) -> str:
    """The most frequent fault of the views here, which look for the points there; empty if most are sound."""
    points = np.unique(np.concatenate([there.observed_points(k) for k in there_side]))
    points = points[points >= 0].astype(np.int32)
    faults, bar = [], config.far_bar if far else config.bar
    for k in here_side[: config.views]:
        S_cam_there = here.T_cam_map(k) @ S_here_there
        seen = support(there, points, S_cam_there, here.features(k), config.radius_px, near=far)
        fault = bar.fault(seen)
        kind, supposed = "loop" if here is there else "join", (there.map_id, log.new_frame, log.old_frame)
        note(
            kind, supposed, there, there_side[0], S_cam_there, here.features(k), points, fault,
            log.unseen, 0.0,
        )  # fmt: skip
        if seen.expected >= config.min_expected:
            faults.append(fault)
    if not faults:
        return "expected_points_missing"
    if faults.count("") >= config.min_sound * len(faults):
        return ""
    return max((f for f in faults if f), key=faults.count)


def _neighbours_agree(
    old: Map,
    new: Map,
    found: Alignment,
    old_side: list[int],
    new_side: list[int],
    rng: np.random.Generator,
    config: PlaceCheckConfig,
) -> bool:
    """Align further pairs of keyframes on their own, and compare the similarities."""
    more = config.pairs // 2
    pairs = [(found.old_keyframe, k) for k in new_side[1 : 1 + more]]
    pairs += [(k, found.new_keyframe) for k in old_side[1 : 1 + more]]
    agreeing = 0
    for old_keyframe, new_keyframe in pairs:
        other, _, _ = align(old, new, old_keyframe, new_keyframe, rng, config.alignment)
        agreeing += other is not None and agree(old, other, found, config.agreement)
    return agreeing >= config.min_agreeing * len(pairs)
