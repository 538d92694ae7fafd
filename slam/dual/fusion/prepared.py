"""Fusion of two maps on copies of them, to be taken over between two frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from dslab.slam.core.relation import Relation
from dslab.slam.dual.fusion.fuse import Fused, fuse, seam_frame
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map.map import Map
from dslab.slam.map.relation import fusion_relation
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.places.recognition import BowVector, shipped_vocabulary


@dataclass(frozen=True)
class PreparedFusion:
    """A fused map that waits to take the place of the two.

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
        seam_only: bool,
        renewed_until: int,
    ) -> Self:
        """Fuse copies of two maps.

        Args:
            old: left unchanged.
            new: a copy already; changed, and not to be used afterwards.
            alignments, mapping, renewed_until: as for :func:`fuse`.
            seam_only: the relation asserts nothing of the old map after the seam.
        """
        accepted, last = alignments[-1], seam_frame(old, alignments) if seam_only else None
        map_ = old.copy()
        fused = fuse(map_, new, alignments, mapping, renewed_until)
        relation = fusion_relation(
            map_, fused.keyframes, accepted.old_keyframe, accepted.new_keyframe + fused.keyframes, last
        )
        vocabulary = shipped_vocabulary()
        bows = {
            int(k): vocabulary.transform(map_.features(int(k)).descriptors)
            for k in map_.keyframes()
            if k >= fused.keyframes
        }
        return cls(old.map_id, new.map_id, map_, fused, accepted, relation, bows)
