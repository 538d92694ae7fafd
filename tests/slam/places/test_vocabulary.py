"""The vocabulary: tree, training, bag of words and the shipped file."""

import numpy as np
import pytest

from dslab.slam.places import _vocabulary_kernels as kernels
from dslab.slam.places.recognition import VOCABULARY_FILE, BowVector, Vocabulary, shipped_vocabulary
from dslab.slam.places.training import cluster, train_vocabulary


def random_images(seed=0, images=12, features=300, places=40, flips=12):
    """Descriptors scattered around a few centres, different ones in each image."""
    rng = np.random.default_rng(seed)
    centres = rng.integers(0, 2**64, (places, 4), dtype=np.uint64)
    made = []
    for _ in range(images):
        shown = rng.choice(places, places // 2, replace=False)
        made.append(scattered(centres[rng.choice(shown, features)], flips, rng))
    return made


def scattered(descriptors, flips, rng):
    result = descriptors.copy()
    for _ in range(flips):
        word, bit = rng.integers(0, 4, len(result)), rng.integers(0, 64, len(result), dtype=np.uint64)
        result[np.arange(len(result)), word] ^= np.uint64(1) << bit
    return result


def distances(a, b):
    """(n, m) Hamming distances by NumPy."""
    bits = [np.unpackbits(np.ascontiguousarray(x).view(np.uint8).reshape(len(x), 32), axis=1) for x in (a, b)]
    return (bits[0][:, None] != bits[1][None]).sum(axis=2)


def slow_descend(tree, descriptor):
    node = 0
    while tree.n_children[node]:
        children = np.arange(tree.n_children[node]) + tree.first_child[node]
        node = int(children[np.argmin(distances(descriptor[None], tree.descriptor[children])[0])])
    return tree.word[node]


@pytest.fixture(scope="module")
def images():
    return random_images()


@pytest.fixture(scope="module")
def vocabulary(images):
    return train_vocabulary(images, 5, 3, 7)


# -- the tree ------------------------------------------------------------------------------------------------


def test_words_agree_with_numpy(vocabulary, images):
    descriptors = images[3][:80]
    words = kernels.descend(vocabulary.tree, descriptors)
    assert words.tolist() == [int(slow_descend(vocabulary.tree, d)) for d in descriptors]


def test_every_word_is_a_leaf_once_and_every_node_the_child_of_one(vocabulary):
    tree = vocabulary.tree
    leaves = tree.n_children == 0
    assert sorted(tree.word[leaves]) == list(range(vocabulary.n_words))
    assert (tree.word[~leaves] == -1).all()
    children = np.concatenate(
        [np.arange(n) + f for f, n in zip(tree.first_child[~leaves], tree.n_children[~leaves], strict=True)]
    )
    assert sorted(children) == list(range(1, len(leaves)))


# -- training ------------------------------------------------------------------------------------------------


def test_training_is_fixed_by_its_seed(images, vocabulary, tmp_path):
    files = [tmp_path / f"{n}.npz" for n in range(3)]
    for file, seed in zip(files, (7, 7, 8), strict=True):
        train_vocabulary(images, 5, 3, seed).save(file)
    first, again, other = (file.read_bytes() for file in files)
    assert first == again
    assert first != other


def test_existing_clusters_are_found():
    rng = np.random.default_rng(3)
    centres = rng.integers(0, 2**64, (6, 4), dtype=np.uint64)
    truth = rng.integers(0, 6, 600)
    found, owner = cluster(scattered(centres[truth], 6, rng), 6, np.random.default_rng(0))
    assert len(found) == 6
    # The majority of a hundred descriptors, each with six bits off, is the centre to the bit.
    nearest = distances(found, centres)
    assert sorted(nearest.argmin(axis=1)) == list(range(6)) and (nearest.min(axis=1) == 0).all()
    assert (nearest.argmin(axis=1)[owner] == truth).all()


def test_with_few_descriptors_each_is_a_word():
    rng = np.random.default_rng(0)
    few = rng.integers(0, 2**64, (3, 4), dtype=np.uint64)
    found, owner = cluster(np.repeat(few, 5, axis=0), 10, rng)
    assert sorted(found.tolist()) == sorted(few.tolist())
    assert (found[owner] == np.repeat(few, 5, axis=0)).all()
    vocabulary = train_vocabulary([few[:1], few[1:]], 10, 4, 0)
    assert vocabulary.n_words == 3


def test_rare_words_have_more_weight(vocabulary, images):
    words = [np.unique(kernels.descend(vocabulary.tree, image)) for image in images]
    shown = np.bincount(np.concatenate(words), minlength=vocabulary.n_words)
    expected = np.log(len(images) / np.maximum(shown, 1))
    assert vocabulary.tree.weight == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("images", "branching", "levels"), [([], 10, 4), ("some", 1, 4), ("some", 10, 0)])
def test_invalid_training_is_refused(images, branching, levels):
    with pytest.raises(ValueError):
        train_vocabulary(random_images(images=2) if images else [], branching, levels, 0)


# -- the bag of words ----------------------------------------------------------------------------------------


def test_weights_are_term_frequency_times_inverse_document_frequency(vocabulary, images):
    bow = vocabulary.transform(images[0])
    words = kernels.descend(vocabulary.tree, images[0])
    expected = {}
    for word in words:
        expected[int(word)] = expected.get(int(word), 0.0) + vocabulary.tree.weight[word]
    total = sum(expected.values())
    expected = {word: weight / total for word, weight in expected.items() if weight > 0}
    assert bow.words.tolist() == sorted(expected)
    assert bow.weights == pytest.approx([expected[w] for w in sorted(expected)])


def test_the_score_is_one_minus_half_the_distance(vocabulary, images):
    a, b = vocabulary.transform(images[0]), vocabulary.transform(images[1])
    dense = np.zeros((2, vocabulary.n_words))
    for row, bow in zip(dense, (a, b), strict=True):
        row[bow.words] = bow.weights
    assert a.score(b) == pytest.approx(1 - 0.5 * np.abs(dense[0] - dense[1]).sum())
    assert a.score(a) == pytest.approx(1) and b.score(a) == a.score(b)


def test_no_features_give_no_words(vocabulary):
    bow = vocabulary.transform(np.empty((0, 4), np.uint64))
    assert len(bow.words) == len(bow.weights) == 0
    assert bow.score(bow) == 0


# -- the file ------------------------------------------------------------------------------------------------


def test_a_saved_vocabulary_is_read_back_unchanged(vocabulary, images, tmp_path):
    kept = Vocabulary(vocabulary.tree, {"seed": 7})
    kept.save(tmp_path / "words.npz")
    read = Vocabulary.load(tmp_path / "words.npz")
    assert read.provenance == {"seed": 7}
    for mine, theirs in zip(vocabulary.tree, read.tree, strict=True):
        assert (mine == theirs).all() and mine.dtype == theirs.dtype
    assert isinstance(read.transform(images[0]), BowVector)


def test_another_file_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="not a vocabulary"):
        Vocabulary.load(tmp_path / "other.npz")


def test_the_shipped_vocabulary_is_small_and_has_its_provenance():
    assert VOCABULARY_FILE.stat().st_size < 1_000_000
    vocabulary = shipped_vocabulary()
    assert vocabulary.n_words > 9000
    facts = vocabulary.provenance
    assert facts["images"] == "rendered by this project"
    assert facts["frames"] > 500 and facts["descriptors"] > 100 * vocabulary.n_words / 4
    assert facts["scenarios"] and min(facts["seeds"]) >= 1000 and facts["seed"] == 0
    assert shipped_vocabulary() is vocabulary
