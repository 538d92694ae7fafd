"""Map fusion: make one map of two, given a similarity between them. Source: paper, Sec. III-C, Eq. 2."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from dslab.slam.core.relation import Relation
from dslab.slam.core.settings import setting, settings
from dslab.slam.loop_closing.correction import move_map
from dslab.slam.loop_closing.essential_graph import essential_edges
from dslab.slam.loop_closing.map_alignment import Agreement, Alignment, Sim3AlignmentConfig, agree
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.map.relation import fusion_relation
from dslab.slam.mapping.local_mapping import LocalMapper, LocalMappingConfig
from dslab.slam.mapping.rules import MapRules, map_rules
from dslab.slam.optimization.pose_graph import optimize_pose_graph
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_inverse
from dslab.slam.optimization.sim3_algebra import invert_sim3
from dslab.slam.places.recognition import BowVector, shipped_vocabulary


@settings
class FusionConfig(Agreement, Sim3AlignmentConfig):
    """Acceptance thresholds of a fusion: of each alignment, of several together, and of the place."""

    max_time_gap_s: float = setting(0.17, "most time between keyframes that are compared")
    confirmations: int = setting(2, "alignments that must agree, at different old keyframes")


def confirms(old: Map, first: Alignment, second: Alignment, config: FusionConfig) -> bool:
    """Return True if two alignments with one old map, at different keyframes of it, agree."""
    if first.old_map_id != second.old_map_id or first.old_keyframe == second.old_keyframe:
        return False
    return agree(old, first, second, config)


@dataclass(frozen=True)
class Fused:
    """Position of the new map's rows in the fused map.

    Attributes:
        keyframes, points: offsets of its rows in the old map.
        factor: (n_keyframes,) scale change of lengths around each keyframe, from the seam's optimisation.
    """

    keyframes: int
    points: int
    factor: np.ndarray


def fuse(
    old: Map,
    new: Map,
    alignments: Sequence[Alignment],
    mapping: LocalMappingConfig,
    renewed_until: int = -1,
) -> Fused:
    """Fuse the new map into the old one, whose frame is kept.

    The last alignment places the new map. If there are more, the essential graph over the seam is optimised
    with all of them. Then all new keyframes are bundle-adjusted, not only those at the seam: a map that was
    carried through a breakage may have lost some of its scale there, and the old map's points that it now
    shares give it back. The old keyframes are fixed.

    Args:
        old: changed in place.
        new: moved into the old map's frame in place, then copied.
        alignments: those that agree; the accepted one last.
        mapping: settings of the seam's fusion and bundle adjustment.
        renewed_until: cull the old keyframes younger than the seam, up to this frame: a recovery has covered
            them again, and the breakage may have corrupted them. -1: cull none.
    """
    accepted = alignments[-1]
    _cull_between(old, seam_frame(old, alignments), renewed_until)
    new.transform(*sim3_decompose(accepted.S_old_new))
    keyframes, points = old.absorb(new)
    for k in range(keyframes, old.n_keyframes):
        if old.parent(k) < 0:
            old.set_parent(k, accepted.old_keyframe)
    for alignment in reversed(alignments):
        theirs = (alignment.new_points + points).astype(np.int32)
        kernels.replace_points(old.arrays, theirs, alignment.old_points, old.view)
    factor = _optimize_seam(old, alignments, keyframes)
    _fuse_seam(old, accepted.old_keyframe, accepted.new_keyframe + keyframes, map_rules(old, mapping))
    is_new = ~old.arrays.kf_bad[: old.n_keyframes] & (np.arange(old.n_keyframes) >= keyframes)
    LocalMapper(old, mapping).adjust_keyframes(is_new)
    return Fused(keyframes, points, factor)


@dataclass(frozen=True)
class FusedMaps:
    """Two maps fused on copies, to be put in their place between two frames.

    Attributes:
        old_id, new_id: the maps; the old one's frame is kept.
        map: the fused copy, with the old one's id.
        fused: position of the new map's rows in it.
        accepted: the alignment.
        relation: what the fusion asserts.
        bows: bags of words of the new map's keyframes, by their rows in the fused map.
    """

    old_id: int
    new_id: int
    map: Map
    fused: Fused
    accepted: Alignment
    relation: Relation
    bows: dict[int, BowVector]

    @classmethod
    def of(
        cls,
        old: Map,
        new: Map,
        alignments: Sequence[Alignment],
        mapping: LocalMappingConfig,
        renewed_until: int | None = None,
    ) -> Self:
        """Fuse copies of two maps.

        Args:
            old: left unchanged.
            new: a copy already; changed, and not to be used afterwards.
            alignments, mapping: as for :func:`fuse`.
            renewed_until: last frame of the old map that a recovery has covered again, so that nothing is
                asserted of the old map after the seam; None without a recovery.
        """
        accepted, last = alignments[-1], None if renewed_until is None else seam_frame(old, alignments)
        map_ = old.copy()
        fused = fuse(map_, new, alignments, mapping, -1 if renewed_until is None else renewed_until)
        relation = fusion_relation(
            map_, fused.keyframes, accepted.old_keyframe, accepted.new_keyframe + fused.keyframes, last
        )
        rows, vocabulary = map_.keyframes(), shipped_vocabulary()
        bows = {
            int(k): vocabulary.transform(map_.features(int(k)).descriptors)
            for k in rows[rows >= fused.keyframes]
        }
        return cls(old.map_id, new.map_id, map_, fused, accepted, relation, bows)


def seam_frame(old: Map, alignments: Sequence[Alignment]) -> int:
    """Index of the youngest frame at which the two maps were aligned."""
    return max(old.frame_index(a.old_keyframe) for a in alignments)


def _cull_between(old: Map, seam: int, last: int) -> None:
    for k in old.keyframes():
        if seam < old.frame_index(int(k)) <= last and old.parent(int(k)) >= 0:
            old.cull_keyframe(int(k))


def _optimize_seam(fused: Map, alignments: Sequence[Alignment], first_new: int) -> np.ndarray:
    """Optimise the new map's essential graph over the seam; (n_keyframes,) scale change of lengths."""
    rows = fused.keyframes()
    bad = fused.arrays.kf_bad
    standing = [a for a in alignments if not (bad[a.new_keyframe + first_new] or bad[a.old_keyframe])]
    seam = [(a.new_keyframe + first_new, a.old_keyframe) for a in standing]
    fused.loop_edges += seam
    if len(seam) < 2:
        return np.ones(fused.n_keyframes)
    T = fused.arrays.kf_T_cam_map
    inner = essential_edges(fused)
    inner = inner[inner.min(axis=1) >= first_new]
    to_placed = alignments[-1].S_old_new
    measured = [
        # The new keyframe has the pose of the last alignment: express it by this one.
        T[i] @ to_placed @ sim3_inverse(a.S_old_new) @ np.linalg.inv(T[j])
        for (i, j), a in zip(seam, standing, strict=True)
    ]
    slot = np.full(fused.n_keyframes, -1)
    slot[rows] = np.arange(len(rows))
    result = optimize_pose_graph(
        T[rows],
        slot[np.concatenate([inner, np.array(seam)])],
        np.concatenate([T[inner[:, 0]] @ invert_sim3(T[inner[:, 1]]), measured]),
        rows < first_new,
    )
    S = T[: fused.n_keyframes].copy()
    S[rows] = result.S_cam_map
    return move_map(fused, S)


def _fuse_seam(fused: Map, old_keyframe: int, new_keyframe: int, rules: MapRules) -> None:
    """Fuse the remaining duplicate points around the seam, in both directions."""
    old_side = [old_keyframe, *fused.neighbours(old_keyframe, 10)]
    new_side = [new_keyframe, *fused.neighbours(new_keyframe, 10)]
    for targets, sources in ((new_side, old_side), (old_side, new_side)):
        points = np.unique(np.concatenate([fused.observed_points(int(k)) for k in sources]))
        points = points[points >= 0].astype(np.int32)
        for k in targets:
            rules.seek(int(k), points, joining=True)
