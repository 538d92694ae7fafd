"""Training of a vocabulary by hierarchical k-majority clustering, deterministic given a seed.

Source: Galvez-Lopez, Tardos, "Bags of Binary Words for Fast Place Recognition in Image Sequences", 2012,
section III; seeding as in Arthur, Vassilvitskii, "k-means++", 2007.
"""

import numpy as np
from numba import njit

from dslab.slam.core.seeds import rng_for
from dslab.slam.features._hamming import hamming
from dslab.slam.places import _vocabulary_kernels as kernels
from dslab.slam.places._vocabulary_kernels import Tree
from dslab.slam.places.recognition import Vocabulary

_ITERATIONS = 12


def train_vocabulary(
    images: list[np.ndarray], branching: int, levels: int, seed: int, provenance: dict | None = None
) -> Vocabulary:
    """Cluster descriptors into a tree and weigh its words.

    Args:
        images: (n, 4) uint64 descriptors per training image.
        branching: children of a node.
        levels: steps from the root to a word.
        seed: seed of the clustering.
        provenance: description of the images, stored with the vocabulary.

    Raises:
        ValueError: there is no descriptor, or the tree has no level or branch.
    """
    if branching < 2 or levels < 1:
        raise ValueError(f"a tree of {levels} levels with {branching} branches has no words")
    descriptors = np.concatenate(images) if images else np.empty((0, 4), np.uint64)
    if not len(descriptors):
        raise ValueError("a vocabulary cannot be trained without descriptors")
    tree = _grow(np.ascontiguousarray(descriptors), branching, levels, seed)
    seen_in = np.zeros(len(tree.weight))
    for image in images:
        words = kernels.descend(tree, np.ascontiguousarray(image))
        seen_in[np.unique(words)] += 1
    # A word in no image gets the weight of a word in one image.
    weight = np.log(len(images) / np.maximum(seen_in, 1.0)).astype(np.float32).astype(np.float64)
    return Vocabulary(tree._replace(weight=weight), provenance or {})


def _grow(descriptors: np.ndarray, branching: int, levels: int, seed: int) -> Tree:
    """Build the tree level by level; a node too small to divide is a word."""
    centres = [np.zeros((1, 4), np.uint64)]
    first_child, n_children = [0], [0]
    open_nodes = [(0, np.arange(len(descriptors)))]
    count = 1
    for level in range(levels):
        below = []
        for node, rows in open_nodes:
            rng = rng_for(seed, "vocabulary", level, node)
            found, owner = cluster(descriptors[rows], branching, rng)
            if len(found) < 2 and level > 0:
                continue
            first_child[node], n_children[node] = count, len(found)
            centres.append(found)
            below += [(count + c, rows[owner == c]) for c in range(len(found))]
            first_child += [0] * len(found)
            n_children += [0] * len(found)
            count += len(found)
        open_nodes = below
    children = np.array(n_children, np.int32)
    word = np.full(count, -1, np.int32)
    word[children == 0] = np.arange((children == 0).sum())
    return Tree(
        np.concatenate(centres),
        np.array(first_child, np.int32),
        children,
        word,
        np.zeros(int((children == 0).sum())),
    )


def cluster(descriptors: np.ndarray, k: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Divide descriptors into at most ``k`` clusters by k-majority.

    Args:
        descriptors: (n, 4) uint64, n > 0.
        k: number of clusters.
        rng: stream of the seeding.

    Returns:
        centres (c, 4) uint64, each bit that of the cluster's majority, owner (n,) int64. No cluster is empty;
        fewer than ``k`` if there are fewer different descriptors.
    """
    centres = _seeds(descriptors, k, rng)
    owner = np.full(len(descriptors), -1, np.int64)
    for _ in range(_ITERATIONS):
        if not _assign(descriptors, centres, owner):
            break
        centres = _majority(descriptors, owner, centres)
    kept, owner = np.unique(owner, return_inverse=True)
    return centres[kept], owner


def _seeds(descriptors: np.ndarray, k: int, rng: np.random.Generator) -> np.ndarray:
    """Initial centres, each drawn in proportion to its squared distance to the previous ones."""
    chosen = [int(rng.integers(len(descriptors)))]
    nearest = np.full(len(descriptors), 1 << 30, np.int64)
    while len(chosen) < k:
        _approach(descriptors, chosen[-1], nearest)
        total = np.cumsum(nearest * nearest)
        if total[-1] == 0:
            break
        chosen.append(int(np.searchsorted(total, rng.integers(total[-1]), side="right")))
    return descriptors[chosen].copy()


@njit(cache=True, nogil=True)
def _approach(descriptors, chosen, nearest):
    for i in range(descriptors.shape[0]):
        nearest[i] = min(nearest[i], hamming(descriptors, i, descriptors, chosen))


@njit(cache=True, nogil=True)
def _assign(descriptors, centres, owner):
    """Assign every descriptor to its nearest centre, the first of equals; number of changes."""
    changed = 0
    for i in range(descriptors.shape[0]):
        best, least = 0, 257
        for c in range(centres.shape[0]):
            distance = hamming(descriptors, i, centres, c)
            if distance < least:
                best, least = c, distance
        changed += best != owner[i]
        owner[i] = best
    return changed


@njit(cache=True, nogil=True)
def _majority(descriptors, owner, centres):
    """Centres with the majority's bits; a centre without members is kept."""
    k = centres.shape[0]
    ones = np.zeros((k, 256), np.int64)
    members = np.zeros(k, np.int64)
    for i in range(descriptors.shape[0]):
        c = owner[i]
        members[c] += 1
        for w in range(4):
            word = descriptors[i, w]
            for b in range(64):
                ones[c, 64 * w + b] += np.int64((word >> np.uint64(b)) & np.uint64(1))
    result = centres.copy()
    for c in range(k):
        if members[c] == 0:
            continue
        for w in range(4):
            word = np.uint64(0)
            for b in range(64):
                if 2 * ones[c, 64 * w + b] > members[c]:
                    word |= np.uint64(1) << np.uint64(b)
            result[c, w] = word
    return result
