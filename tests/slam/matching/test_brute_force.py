import numpy as np
import pytest
from numba import njit

from dslab.slam.features._hamming import hamming, hamming256, popcount64
from dslab.slam.matching.brute_force import match_brute_force, match_oriented


def random_descriptors(rng, n):
    return rng.integers(0, 2**64, (n, 4), dtype=np.uint64)


def with_flipped_bits(rng, desc, n_bits):
    bits = np.unpackbits(desc.view(np.uint8), axis=1)
    for row in bits:
        row[rng.choice(256, n_bits, replace=False)] ^= 1
    return np.packbits(bits, axis=1).view(np.uint64)


def distances(desc_a, desc_b):
    a, b = (np.unpackbits(np.ascontiguousarray(d).view(np.uint8), axis=1) for d in (desc_a, desc_b))
    return (a[:, None] != b[None]).sum(axis=2)


def slow_matches(desc_a, desc_b, max_distance, ratio):
    table = distances(desc_a, desc_b)
    owner = {}
    for i, row in enumerate(table):
        j = int(row.argmin())
        second = np.delete(row, j).min() if len(row) > 1 else 1023
        if row[j] > max_distance or row[j] >= ratio * second:
            continue
        if j not in owner or row[j] < table[owner[j], j]:
            owner[j] = i
    return np.array(sorted((i, j) for j, i in owner.items()), np.int32).reshape(-1, 2)


@njit
def _popcount(word):
    return popcount64(word)


def test_popcount_counts_the_bits():
    words = [0, 1, 2**63, 2**64 - 1, 0x5555555555555555, 0x8000000000000001]
    assert [_popcount(np.uint64(w)) for w in words] == [bin(w).count("1") for w in words]


def test_hamming_equals_the_bits_that_differ():
    rng = np.random.default_rng(0)
    a, b = random_descriptors(rng, 20), random_descriptors(rng, 20)
    b[0], b[1] = a[0], ~a[1]
    table = distances(a, b)
    assert table[0, 0] == 0 and table[1, 1] == 256
    for i in range(20):
        assert hamming256(a[i], b[i]) == table[i, i]
        assert hamming(a, i, b, 19 - i) == table[i, 19 - i]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("max_distance", "ratio"), [(60, 0.8), (256, 1.0), (120, 0.95), (0, 1.0)])
def test_matches_agree_with_numpy(seed, max_distance, ratio):
    rng = np.random.default_rng(seed)
    b = random_descriptors(rng, 90)
    # Several of A want the same one of B, at different and at equal distances.
    a = np.concatenate(
        [random_descriptors(rng, 30), *(with_flipped_bits(rng, b[:40], n) for n in (0, 20, 20, 50))]
    )
    a = a[rng.permutation(len(a))]
    matches = match_brute_force(a, b, max_distance, ratio)
    assert matches.dtype == np.int32
    assert np.array_equal(matches, slow_matches(a, b, max_distance, ratio))
    assert len(np.unique(matches[:, 0])) == len(np.unique(matches[:, 1])) == len(matches) > 0


def test_noisy_copies_find_their_originals():
    rng = np.random.default_rng(5)
    a = random_descriptors(rng, 500)
    order = rng.permutation(500)
    matches = match_brute_force(a, with_flipped_bits(rng, a[order], 25), 50, 0.8)
    assert len(matches) == 500 and (order[matches[:, 1]] == matches[:, 0]).all()


def test_ambiguous_descriptor_is_not_matched():
    rng = np.random.default_rng(6)
    a = random_descriptors(rng, 1)
    pairs = np.concatenate([with_flipped_bits(rng, a, 20), with_flipped_bits(rng, a, 21)])
    assert len(match_brute_force(a, pairs, 50, 0.9)) == 0
    assert match_brute_force(a, pairs, 50, 0.99).tolist() == [[0, 0]]


def test_single_candidate_passes_the_ratio():
    rng = np.random.default_rng(7)
    a = random_descriptors(rng, 3)
    assert match_brute_force(a, a[1:2].copy(), 50, 0.6).tolist() == [[1, 0]]


@pytest.mark.parametrize(("n", "m"), [(0, 5), (5, 0), (0, 0)])
def test_empty_inputs_have_no_matches(n, m):
    rng = np.random.default_rng(8)
    matches = match_brute_force(random_descriptors(rng, n), random_descriptors(rng, m), 256, 1.0)
    assert matches.shape == (0, 2) and matches.dtype == np.int32


def test_wrong_descriptors_are_refused_by_name():
    good = np.zeros((3, 4), np.uint64)
    with pytest.raises(ValueError, match="desc_a"):
        match_brute_force(np.zeros((3, 32), np.uint8), good, 50, 0.8)
    with pytest.raises(ValueError, match="desc_b"):
        match_brute_force(good, good[0], 50, 0.8)


def test_layout_of_the_input_does_not_matter():
    rng = np.random.default_rng(9)
    a = random_descriptors(rng, 60)
    strided = np.repeat(a, 2, axis=0)[::2]
    strided.setflags(write=False)
    assert match_brute_force(strided, a, 10, 0.8).tolist() == [[i, i] for i in range(60)]


def test_matches_are_kept_that_turn_alike():
    rng = np.random.default_rng(10)
    desc, angle = random_descriptors(rng, 100), rng.uniform(0, 360, 100).astype(np.float32)
    turned = ((angle + np.where(np.arange(100) < 80, 300, 120)) % 360).astype(np.float32)
    pairs = match_oriented(desc, angle, desc, turned, 50, 0.8)
    assert pairs.tolist() == [[i, i] for i in range(80)]
    assert match_oriented(desc[:0], angle[:0], desc, turned, 50, 0.8).shape == (0, 2)
