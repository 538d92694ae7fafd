"""Removal from a map of what it has learned since a frame."""

from dslab.slam.map.map import Map


def cull_since(map_: Map, first_frame: int) -> tuple[int, ...]:
    """Cull the keyframes made of the frames from ``first_frame`` on, but no root of the spanning tree.

    Points that then have too few observers are dropped. Poses and points that stay are left where they are.

    Returns:
        Rows of the culled keyframes, newest first.
    """
    doubted = [
        int(k)
        for k in reversed(map_.keyframes())
        if map_.frame_index(int(k)) >= first_frame and map_.parent(int(k)) >= 0
    ]
    for k in doubted:
        map_.cull_keyframe(k)
    return tuple(doubted)
