"""Kernels of place recognition: vocabulary tree and inverted file."""

from typing import NamedTuple

import numpy as np
from numba import njit

from dslab.slam.features._hamming import hamming


class Tree(NamedTuple):
    """Vocabulary tree; node 0 is the root, the children of a node are consecutive.

    Attributes:
        descriptor: (N, 4) uint64 centre of each node.
        first_child: (N,) int32.
        n_children: (N,) int32, 0 for a word.
        word: (N,) int32 number of the word, -1 for inner nodes.
        weight: (W,) float64 inverse document frequency of each word.
    """

    descriptor: np.ndarray
    first_child: np.ndarray
    n_children: np.ndarray
    word: np.ndarray
    weight: np.ndarray


class InvertedFile(NamedTuple):
    """Keyframes that contain each word, one block of entries per word.

    Attributes:
        start: (W,) int64 first entry of each word's block.
        length: (W,) int32 entries in use.
        capacity: (W,) int32 entries of the block.
        keyframe: (E,) int32.
        weight: (E,) float64 weight of the word in that keyframe.
    """

    start: np.ndarray
    length: np.ndarray
    capacity: np.ndarray
    keyframe: np.ndarray
    weight: np.ndarray


@njit(cache=True, nogil=True)
def descend(tree, descriptors):
    """Word of each descriptor.

    Args:
        tree: Tree.
        descriptors: (n, 4) uint64.

    Returns:
        (n,) int32.
    """
    n = descriptors.shape[0]
    words = np.empty(n, np.int32)
    for i in range(n):
        node = 0
        while tree.n_children[node] > 0:
            first = tree.first_child[node]
            best, least = first, 257
            for child in range(first, first + tree.n_children[node]):
                distance = hamming(descriptors, i, tree.descriptor, child)
                if distance < least:
                    best, least = child, distance
            node = best
        words[i] = tree.word[node]
    return words


@njit(cache=True, nogil=True)
def file_words(inverted, end, keyframe, words, weights):
    """Add a keyframe's words; a full block moves to the end with twice its capacity.

    Args:
        inverted: InvertedFile, with enough entries from ``end`` on.
        end: first entry outside all blocks.
        keyframe: row.
        words, weights: its bag of words.

    Returns:
        The new end.
    """
    for i in range(len(words)):
        w = words[i]
        count = inverted.length[w]
        if count == inverted.capacity[w]:
            old = inverted.start[w]
            inverted.keyframe[end : end + count] = inverted.keyframe[old : old + count]
            inverted.weight[end : end + count] = inverted.weight[old : old + count]
            inverted.start[w] = end
            inverted.capacity[w] = grown(count)
            end += inverted.capacity[w]
        entry = inverted.start[w] + count
        inverted.keyframe[entry] = keyframe
        inverted.weight[entry] = weights[i]
        inverted.length[w] = count + 1
    return end


@njit(cache=True, nogil=True)
def grown(capacity):
    """Capacity of a block after it has grown."""
    return max(4, 2 * capacity)


@njit(cache=True, nogil=True)
def room_needed(inverted, words):
    """Largest number of entries that :func:`file_words` takes from the end."""
    need = 0
    for w in words:
        if inverted.length[w] == inverted.capacity[w]:
            need += grown(inverted.capacity[w])
    return need


@njit(cache=True, nogil=True)
def remove_words(inverted, keyframe, words):
    """Remove a keyframe's words; the last entry of each block fills the gap."""
    for w in words:
        last = inverted.start[w] + inverted.length[w] - 1
        entry = inverted.start[w]
        while inverted.keyframe[entry] != keyframe:
            entry += 1
        inverted.keyframe[entry] = inverted.keyframe[last]
        inverted.weight[entry] = inverted.weight[last]
        inverted.length[w] -= 1


@njit(cache=True, nogil=True)
def look_up(inverted, n_keyframes, words, weights):
    """Compare one image with every keyframe.

    Args:
        inverted: InvertedFile.
        n_keyframes: rows of the result.
        words, weights: the image's bag of words, weights positive with sum 1.

    Returns:
        common (n_keyframes,) int32 words in common; score (n_keyframes,) float64, 1 for the same bag.
    """
    common = np.zeros(n_keyframes, np.int32)
    score = np.zeros(n_keyframes, np.float64)
    for i in range(len(words)):
        start = inverted.start[words[i]]
        for entry in range(start, start + inverted.length[words[i]]):
            k = inverted.keyframe[entry]
            common[k] += 1
            # 1 - |a - b| / 2 of two vectors of norm 1 is the sum of the smaller of each pair.
            score[k] += min(weights[i], inverted.weight[entry])
    return common, score


@njit(cache=True, nogil=True)
def score_groups(possible, score, covisibility, least):
    """Score candidates together with the keyframes that are connected with them.

    Args:
        possible: (K,) bool candidates.
        score: (K,) float64.
        covisibility: (C, C) int32, C >= K, points that two keyframes share.
        least: shared points that connect two keyframes.

    Returns:
        total (K,) float64 sum of the scores of the group's candidates; best (K,) int32 the group's candidate
        with the highest score, the first of several. Zero and -1 for keyframes that are no candidates.
    """
    n = len(possible)
    total = np.zeros(n, np.float64)
    best = np.full(n, -1, np.int32)
    for k in range(n):
        if not possible[k]:
            continue
        for j in range(n):
            if possible[j] and (j == k or covisibility[k, j] >= least):
                total[k] += score[j]
                if best[k] < 0 or score[j] > score[best[k]]:
                    best[k] = j
    return total, best
