"""Places that look alike: what a map has learnt of them from loops that its geometry has refuted.

Where two places look the same, no view of one tells it from the other. But a camera that has been at both
knows that they are two: the loop is refused, and the similarity between them is kept. A world that repeats
itself once may do so elsewhere: whoever supposes a place has to ask whether its double would do as well.
"""

import numpy as np

from dslab.slam.core.geometry import camera_centre
from dslab.slam.loop_closing.correction import Loop
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_inverse

_MIN_TURN_DEG = 30.0
_MIN_SHIFT = 3.0  # median depths; a smaller misfit may be drift
_SAME = 1.0  # median depths between two doubles that count as one
_MOST = 50


def note_look_alike(map_: Map, loop: Loop) -> None:
    """Remember the two places of a loop that the corrected map has spoken against."""
    T_other, T = map_.T_cam_map(loop.loop_keyframe), map_.T_cam_map(loop.keyframe)
    S = T_other @ loop.alignment.S_old_new @ np.linalg.inv(T)
    depth = kernels.median_depth(map_.arrays, loop.keyframe)
    centre = camera_centre(T)
    double = _moved(loop.alignment.S_old_new, centre)
    _, R, _ = sim3_decompose(S)
    here = T @ np.linalg.inv(T_other)
    turn_deg = np.rad2deg(np.arccos(np.clip((np.trace(R @ here[:3, :3]) - 1) / 2, -1, 1)))
    if turn_deg < _MIN_TURN_DEG and np.linalg.norm(double - centre) < _MIN_SHIFT * depth:
        return
    known = any(np.linalg.norm(_moved(A, centre) - double) < _SAME * depth for A in look_alikes(map_))
    if not known and len(map_.look_alikes) < _MOST:
        map_.look_alikes.append((loop.keyframe, loop.loop_keyframe, S))


def look_alikes(map_: Map) -> list[np.ndarray]:
    """(4, 4) similarities within a map that take a place to its double."""
    return [
        np.linalg.inv(map_.T_cam_map(other)) @ S @ map_.T_cam_map(keyframe)
        for keyframe, other, S in map_.look_alikes
    ]


def doubles(old: Map, new: Map, S_old_new: np.ndarray) -> list[np.ndarray]:
    """Where else the new map would look as it does, as far as both maps know: (4, 4) similarities."""
    there, back = [[*found, *map(sim3_inverse, found)] for found in (look_alikes(old), look_alikes(new))]
    return [A @ S_old_new for A in there] + [S_old_new @ B for B in back]


def _moved(S: np.ndarray, position: np.ndarray) -> np.ndarray:
    return S[:3, :3] @ position + S[:3, 3]
