"""Frames that are decoded once, into the cache: of videos and bags."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dslab.sim.cache import FolderCache, content_key
from dslab.sim.io.folders import Progress
from dslab.sim.io.raw import RawFrames, RawWriter
from dslab.sim.room import Need, check_room

_FRAMES, _STAMPS = "gray.npy", "stamps.npy"


def decoded_once(
    path: Path,
    content: dict[str, Any],
    size: tuple[int, int],
    read_stamps: Callable[[], np.ndarray],
    read_frames: Callable[[int], Iterator[np.ndarray]],
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    force: bool = False,
) -> tuple[np.ndarray, RawFrames]:
    """The (N,) stamps and N frames of a file, from the cache if they have been decoded before.

    Args:
        path: the file, for faults.
        content: what decides the frames; plain data.
        size: (H, W) of the frames.
        read_stamps: gives the (N,) stamps.
        read_frames: called with N, yields the (H, W) uint8 frames.
        cache_dir: folder of the cache; None for the default one.
        progress: called with (step, frames done, frames in all) while decoding.
        force: begin even if the frames seem too many for the disk.

    Raises:
        InputError: there is no room for the frames, or what the two functions raise.
    """
    store, key = FolderCache(cache_dir), content_key(content)
    if store.find(key) is None:
        stamps = read_stamps()
        count = len(stamps)
        check_room(str(path), count, [Need(store.root, count * size[0] * size[1])], force)
        with store.create(key) as folder:
            np.save(folder / _STAMPS, stamps)
            with RawWriter(folder / _FRAMES, (count, *size), np.uint8) as frames:
                for index, image in enumerate(read_frames(count)):
                    frames.append(image)
                    if progress:
                        progress("decoding", index + 1, count)
    folder = store.root / key
    stamps = np.load(folder / _STAMPS)
    return stamps, RawFrames(folder / _FRAMES, (len(stamps), *size), np.uint8)
