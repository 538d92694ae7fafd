"""A log of hypotheses: every view that was asked for a supposed place, for whoever judges it later."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import numpy as np

from dslab.slam.belief.model import Sight, Unseen
from dslab.slam.belief.sight import rigid_of, settled, sight_of
from dslab.slam.core.frame import FrameFeatures
from dslab.slam.core.relation import Relation
from dslab.slam.map._map_kernels import median_depth
from dslab.slam.map.map import Map
from dslab.slam.map.relation import supposed_relation
from dslab.slam.map.trajectory import keyframe_trajectory


@dataclass(frozen=True)
class LoggedView:
    """One view that was asked for a supposed place.

    Attributes:
        kind: ``relocalization``, ``loop`` or ``join``.
        hypothesis: the map, and the frames of the two views that supposed the place.
        relation: the keyframes around, and where the view is among them: as supposed, and settled there.
        sight: what it should show, and what it shows.
        log_odds: that it is there, as believed since this view.
        unseen: the motion to the place.
        explored: length of the path of the map's keyframes, median depths of the place.
        torn: share of the map's observations that the correction of a loop tears, if this is what was asked
            and no view.
    """

    kind: str
    hypothesis: tuple[int, int, int]
    relation: Relation
    sight: Sight
    log_odds: float
    unseen: Unseen
    explored: float = 0.0
    torn: float = np.nan

    @property
    def proposes(self) -> bool:
        """Whether this is one of the views that supposed the place, and so no evidence."""
        return np.isnan(self.torn) and int(self.relation.new.frames[0]) in self.hypothesis[1:]


_log: ContextVar[list[LoggedView] | None] = ContextVar("hypotheses", default=None)


@contextmanager
def logged() -> Iterator[list[LoggedView]]:
    """Log the hypotheses of all systems that run within, in order."""
    views: list[LoggedView] = []
    token = _log.set(views)
    try:
        yield views
    finally:
        _log.reset(token)


def note(
    kind: str,
    hypothesis: tuple[int, int, int],
    map_: Map,
    keyframe: int,
    S_cam_map: np.ndarray,
    features: FrameFeatures,
    points: np.ndarray,
    log_odds: float,
    unseen: Callable[[], Unseen],
    moved: float | None = None,
    torn: float = np.nan,
) -> None:
    """Put a view down, if hypotheses are logged.

    Args:
        kind, hypothesis, log_odds, unseen, torn: as of :class:`LoggedView`.
        map_: of the place.
        keyframe: row of a keyframe there.
        S_cam_map: (4, 4) supposed similarity from the map to the view's camera.
        features: of the view.
        points: (Q,) int32 points around the place.
        moved: since the place was supposed, lengths of the map, if the pose comes by another map's path; by
            default it was tracked in this one.
    """
    views = _log.get()
    if views is None:
        return
    T_cam_map = rigid_of(S_cam_map)
    depth = median_depth(map_.arrays, keyframe)
    if moved is not None:
        T_cam_map = settled(map_, points, T_cam_map, features, depth, moved)
    relation = supposed_relation(map_, keyframe, features, T_cam_map)
    sight = sight_of(map_, points, T_cam_map, features, depth)
    centres = keyframe_trajectory(map_).T_map_cam[:, :3, 3]
    explored = float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum() / relation.depth)
    views.append(LoggedView(kind, hypothesis, relation, sight, log_odds, unseen(), explored, torn))
