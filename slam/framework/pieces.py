"""Maps that are joined of pieces: what single systems have of them, and poses that recoveries found."""

import numpy as np

from dslab.slam.framework.odometry import Fed
from dslab.slam.optimization.sim3 import moved, sim3_decompose


class Piece:
    """Part of a map.

    Args:
        fed: system whose last map it is; None for poses that stand as they are.
        given: such poses, by frame.

    Attributes:
        S: (4, 4) similarity, from the piece to the map.
        withdrawn: frames whose poses no longer count.
    """

    def __init__(self, fed: Fed | None, given: dict[int, np.ndarray] | None = None) -> None:
        self.fed = fed
        self.S = np.eye(4)
        self.withdrawn: set[int] = set()
        self._given = given or {}

    def poses(self) -> dict[int, np.ndarray]:
        """(4, 4) poses, camera to map, by frame."""
        poses = self._given if self.fed is None else self.fed.poses()
        frames = [frame for frame in poses if frame not in self.withdrawn]
        if not frames:
            return {}
        return dict(zip(frames, moved(self.S, np.array([poses[frame] for frame in frames])), strict=True))


class JoinedMap:
    """A map of one piece or several, in the frame and scale of the first.

    Args:
        map_id: of it.
        fed: system of the first piece.

    Attributes:
        pieces: in order of time.
        size: number of frames with poses, and ``newest`` the last of them, when :meth:`note` was called last.
    """

    def __init__(self, map_id: int, fed: Fed) -> None:
        self.map_id = map_id
        self.pieces = [Piece(fed)]
        self.size, self.newest = 0, -1

    def poses(self) -> dict[int, np.ndarray]:
        """(4, 4) poses, camera to map, by frame."""
        return {frame: T for piece in self.pieces for frame, T in piece.poses().items()}

    def note(self) -> int:
        """Note size and newest frame; the size."""
        poses = self.poses()
        self.size, self.newest = len(poses), max(poses, default=-1)
        return self.size

    def keyframes(self) -> list[int]:
        """Frames that are keyframes of a system."""
        return [f for piece in self.pieces if piece.fed is not None for f in piece.fed.keyframes()]

    def points(self) -> np.ndarray:
        """(N, 3) points of its systems."""
        parts = [np.empty((0, 3))]
        for piece in self.pieces:
            if piece.fed is not None:
                s, R, t = sim3_decompose(piece.S)
                parts.append(s * piece.fed.points() @ R.T + t)
        return np.concatenate(parts)

    def S_of(self, fed: Fed) -> np.ndarray:
        """(4, 4) similarity from the map of a system to this one."""
        return next(piece.S for piece in self.pieces if piece.fed is fed)

    def join(
        self, new: "JoinedMap", S_old_new: np.ndarray, bridge: dict[int, np.ndarray], replaced: set[int]
    ) -> None:
        """Take another map in.

        Args:
            new: the other map.
            S_old_new: (4, 4) similarity from it to this one.
            bridge: (4, 4) poses between the two, in this one, by frame.
            replaced: frames of this one whose poses are among those.
        """
        for piece in self.pieces:
            piece.withdrawn |= replaced
        for piece in new.pieces:
            piece.S = S_old_new @ piece.S
        self.pieces += [Piece(None, bridge), *new.pieces]
