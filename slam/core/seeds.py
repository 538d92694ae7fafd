"""Named random streams: one root seed, one independent stream per consumer."""

import zlib

import numpy as np


def rng_for(seed: int, *names: str | int) -> np.random.Generator:
    """Random stream of one consumer, fixed by the root seed and the consumer's name.

    Adding a consumer changes no other consumer's numbers.

    Args:
        seed: root seed of the run, >= 0.
        names: the consumer, from general to particular, e.g. ``("world", "texture", 17)``.
    """
    key = tuple(n if isinstance(n, int) else zlib.crc32(n.encode()) for n in names)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
