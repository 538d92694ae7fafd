"""Map fusion: one map out of two that a similarity relates. Source: paper, Sec. III-C, Eq. 2."""

from dataclasses import dataclass

import numpy as np

from slam import _map_kernels as kernels
from slam.local_mapping import LocalMapper, LocalMappingConfig
from slam.map import Map
from slam.map_alignment import Alignment, AlignmentConfig
from slam.matching import fuse_into_keyframe
from slam.optimization.sim3 import sim3_decompose, sim3_inverse


@dataclass(frozen=True)
class FusionConfig(AlignmentConfig):
    """Acceptance of a fusion: of each alignment, and of several together.

    Attributes:
        max_frame_gap: frames between keyframes of the two maps that may be compared.
        max_scale_change, max_rotation_deg, max_shift: how far two alignments, at different keyframes of the
            old map, may differ and still confirm each other; the shift is in median depths.
        confirmations: alignments that must agree.
    """

    max_frame_gap: int = 5
    max_scale_change: float = 0.05
    max_rotation_deg: float = 2.0
    max_shift: float = 0.05
    confirmations: int = 2


def agree(old: Map, first: Alignment, second: Alignment, config: FusionConfig) -> bool:
    """Whether two alignments at different keyframes of the old map tell the same similarity."""
    if first.old_map_id != second.old_map_id or first.old_keyframe == second.old_keyframe:
        return False
    s_1, R_1, _ = sim3_decompose(first.S_old_new)
    s_2, R_2, _ = sim3_decompose(second.S_old_new)
    if abs(np.log(s_1 / s_2)) > np.log1p(config.max_scale_change):
        return False
    cosine = np.clip((np.trace(R_1.T @ R_2) - 1) / 2, -1, 1)
    if np.rad2deg(np.arccos(cosine)) > config.max_rotation_deg:
        return False
    depth = kernels.median_depth(old.arrays, second.old_keyframe)
    where = np.append(old.arrays.pt_xyz[second.old_points].mean(0), 1.0)
    moved = (first.S_old_new @ sim3_inverse(second.S_old_new) @ where)[:3]
    return bool(np.linalg.norm(moved - where[:3]) <= config.max_shift * depth)


def fuse(old: Map, new: Map, alignment: Alignment, mapping: LocalMappingConfig) -> tuple[int, int]:
    """Take the new map into the old one, whose frame is kept.

    Old keyframes younger than the seam are by-passed: the recovery has covered their frames anew, and they
    are the ones that the breakage may have corrupted.

    Args:
        old: changed in place.
        new: moved into the old map's frame in place, then copied.
        alignment: the accepted similarity.
        mapping: settings of the seam's fusion and bundle adjustment.

    Returns:
        Offsets of the new map's keyframe and point rows in the old map.
    """
    seam_frame = old.frame_index(alignment.old_keyframe)
    for k in old.keyframes():
        if old.frame_index(int(k)) > seam_frame and old.parent(int(k)) >= 0:
            old.cull_keyframe(int(k))
    new.transform(*sim3_decompose(alignment.S_old_new))
    keyframes, points = old.absorb(new)
    for k in range(keyframes, old.n_keyframes):
        if old.parent(k) < 0:
            old.set_parent(k, alignment.old_keyframe)
    scale = old.view.scale
    for mine, theirs in zip(alignment.old_points, alignment.new_points, strict=True):
        kernels.replace_point(old.arrays, theirs + points, mine, scale)
    _fuse_seam(old, alignment.old_keyframe, alignment.new_keyframe + keyframes)
    LocalMapper(old, mapping).adjust(alignment.new_keyframe + keyframes)
    return keyframes, points


def _fuse_seam(fused: Map, old_keyframe: int, new_keyframe: int) -> None:
    """Join the duplicates that are left about the seam, both ways."""
    old_side = [old_keyframe, *fused.neighbours(old_keyframe, 10)]
    new_side = [new_keyframe, *fused.neighbours(new_keyframe, 10)]
    for targets, sources in ((new_side, old_side), (old_side, new_side)):
        points = np.unique(np.concatenate([fused.observed_points(int(k)) for k in sources]))
        points = points[points >= 0].astype(np.int32)
        for k in targets:
            fuse_into_keyframe(fused.arrays, fused.view, int(k), points, 4.0)
