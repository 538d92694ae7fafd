"""Where the maps of a run are drawn, and from which frame on: for display only, it feeds no figure.

The first map is aligned to the truth, over what it held before another was fused with it. Where a later one
lies is not known when it begins: it is drawn in its own frame, its unit as long as that of the map before,
from where that map's camera was last, moved aside. A fusion puts it where the old map has its frames.
"""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import IDENTITY, Similarity, Undefined, align_poses
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Fusion, MapDropped
from dslab.slam.core.results import MapTrajectory


@dataclass(frozen=True)
class Place:
    """Where a map is drawn from a frame on.

    Attributes:
        frame: the first frame.
        S_world_map: from the map to the world.
        is_own: True while the map is in its own frame, which nothing relates to the truth.
    """

    frame: int
    S_world_map: Similarity
    is_own: bool


class Placements:
    """Places of the maps of a run over time.

    Args:
        record: the run.
        aside: (3,) by which maps in their own frames are moved from where they begin, metres.

    Attributes:
        places: by map id, in order of frames, of the maps that are drawn.
        dropped, absorbed: frame from which a map is no more, by map id.
    """

    def __init__(self, record: RunRecord, aside: np.ndarray) -> None:
        self.places: dict[int, list[Place]] = {}
        self.dropped = {e.map_id: e.frame for e in record.events if isinstance(e, MapDropped)}
        fusions = [e for e in record.events if isinstance(e, Fusion) and e.accepted]
        self.absorbed = {e.new_map_id: e.frame for e in fusions}
        self._record = record
        self._aside = aside
        self._into = {e.new_map_id: e.old_map_id for e in fusions}
        self._final = {path.map_id: path for path in record.trajectories}
        groups = {map_id: {map_id} for map_id in record.live}
        begun = [(int(path.frames[0]), map_id) for map_id, path in record.live.items()]
        for frame, what in sorted([*begun, *((e.frame, e) for e in fusions)], key=lambda item: item[0]):
            if isinstance(what, Fusion):
                self._join(what, groups)
            else:
                self._begin(what, frame, fusions)

    def at(self, map_id: int, frame: int) -> Place | None:
        """Where a map is drawn at a frame; None where it is not."""
        known = [place for place in self.places.get(map_id, []) if place.frame <= frame]
        return known[-1] if known else None

    def is_there(self, map_id: int, frame: int) -> bool:
        """True if a map has begun and is not dropped, whether or not it has become part of another."""
        return self.at(map_id, frame) is not None and frame < self.dropped.get(map_id, frame + 1)

    def stands_alone(self, map_id: int, frame: int) -> bool:
        """True if a map is there and no part of another."""
        return self.is_there(map_id, frame) and frame < self.absorbed.get(map_id, frame + 1)

    def changes(self) -> set[int]:
        """Frames at which a map begins, moves or ends."""
        moves = {place.frame for places in self.places.values() for place in places}
        return moves | set(self.absorbed.values()) | set(self.dropped.values())

    def final(self, map_id: int, frames: np.ndarray, frame: int) -> np.ndarray:
        """(n, 3) positions in the world at a frame of the final poses of ``frames``, as they lie to a map.

        A map that was never tracked in lies as the one into which it was fused.

        NaN for frames without a pose, and if it is not known how the map lies to the final ones.
        """
        map_id = map_id if self.places.get(map_id) else self._root(map_id)
        positions, path = np.full((len(frames), 3), np.nan), self._final.get(self._root(map_id))
        place, S_final_map = self.at(map_id, frame), self._to_final(map_id, len(self._record.results))
        if path is not None and place is not None and S_final_map is not None:
            of = dict(zip(path.frames.tolist(), path.T_map_cam[:, :3, 3], strict=True))
            rows = [row for row, wanted in enumerate(frames.tolist()) if wanted in of]
            known = np.array([of[frames[row]] for row in rows]).reshape(-1, 3)
            S_world_final = _matrix(place.S_world_map) @ np.linalg.inv(S_final_map)
            positions[rows] = _similarity(S_world_final).points(known)
        return positions

    def _begin(self, map_id: int, frame: int, fusions: list[Fusion]) -> None:
        before = self._before(map_id, frame)
        if before is None:
            first = min((e.frame for e in fusions if map_id in (e.old_map_id, e.new_map_id)), default=None)
            aligned = _aligned(self._record, self._record.live[map_id], first)
            self.places[map_id] = [] if aligned is None else [Place(frame, aligned, False)]
            return
        path, place = before
        T_old_new = path.T_map_cam[-1] @ np.linalg.inv(self._record.live[map_id].T_map_cam[0])
        S_world_map = _matrix(place.S_world_map) @ T_old_new
        S_world_map[:3, 3] += 0 if place.is_own else self._aside
        self.places[map_id] = [Place(frame, _similarity(S_world_map), True)]

    def _before(self, map_id: int, frame: int) -> tuple[MapTrajectory, Place] | None:
        """Path up to a frame and place of the map that was used last before another, and is not dropped."""
        found = []
        for other, live in self._record.live.items():
            place, path = self.at(other, frame), live.where(live.frames < frame)
            is_there = self.dropped.get(other, frame + 1) > frame
            if other != map_id and place is not None and is_there and len(path.frames):
                found.append((path, place))
        return max(found, key=lambda item: item[0].frames[-1], default=None)

    def _join(self, fusion: Fusion, groups: dict[int, set[int]]) -> None:
        """Move the maps on one side of a fusion to those on the other: never those that are aligned."""
        kept, moved = fusion.old_map_id, fusion.new_map_id
        places = self.at(kept, fusion.frame), self.at(moved, fusion.frame)
        if places[0] is None or places[1] is None:
            return
        if places[0].is_own and not places[1].is_own:
            kept, moved = moved, kept
        target = self.at(kept, fusion.frame)
        S_final_kept = self._to_final(kept, fusion.frame)
        if target is None or S_final_kept is None:
            return
        S_world_final = _matrix(target.S_world_map) @ np.linalg.inv(S_final_kept)
        for map_id in groups[moved]:
            S_final_map = self._to_final(map_id, fusion.frame)
            if S_final_map is not None:
                place = Place(fusion.frame, _similarity(S_world_final @ S_final_map), target.is_own)
                self.places[map_id].append(place)
        for map_id in (whole := groups[kept] | groups[moved]):
            groups[map_id] = whole

    def _root(self, map_id: int) -> int:
        """The map in which a map is in the end."""
        seen = {map_id}
        while (into := self._into.get(map_id, map_id)) not in seen:
            seen.add(map_id := into)
        return map_id

    def _to_final(self, map_id: int, before: int) -> np.ndarray | None:
        """(4, 4) from a map, by its live poses before a frame, to the map in which it is in the end."""
        live, final = self._record.live.get(map_id), self._final.get(self._root(map_id))
        if live is None or final is None:
            return None
        frames, rows, final_rows = np.intersect1d(live.frames, final.frames, return_indices=True)
        rows, final_rows = rows[frames < before], final_rows[frames < before]
        found = align_poses(live.T_map_cam[rows], final.T_map_cam[final_rows])
        return None if isinstance(found, Undefined) else _matrix(found)


def _aligned(record: RunRecord, path: MapTrajectory, before: int | None) -> Similarity | None:
    """Alignment of a path to the truth, over the frames before one if they suffice."""
    if record.sequence.T_world_cam is None:
        return IDENTITY
    for part in [path] if before is None else [path.where(path.frames < before), path]:
        pairs = Truth.of(record.sequence).pairs(part)
        found = align_poses(pairs.T_map_cam, pairs.T_world_cam)
        if isinstance(found, Similarity):
            return found
    return None


def _matrix(S: Similarity) -> np.ndarray:
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = S.scale * S.R_world_map, S.t_world_map
    return M


def _similarity(M: np.ndarray) -> Similarity:
    scale = float(np.cbrt(np.linalg.det(M[:3, :3])))
    return Similarity(scale, M[:3, :3] / scale, M[:3, 3])
