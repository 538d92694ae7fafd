"""Our vocabulary in the text form of DBoW2, for systems that read that.

    10 6 0 0                        branching, levels, scoring by L1, weights tf-idf
    parent is_word d0 ... d31 weight   a line per node but the root, numbered from 1; a parent comes before

Descriptors are those of OpenCV's ORB, bit by bit, so that such systems find their own features in it. Their
own vocabularies have six levels, and they match features within nodes of the second. Ours has four: with six
in the first line they take its second, too, where features are matched among about ten.
"""

import hashlib
from pathlib import Path

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.sim.cache import FolderCache, content_key
from dslab.slam.places._vocabulary_kernels import Tree
from dslab.slam.places.recognition import VOCABULARY_FILE, Vocabulary, shipped_vocabulary

_FILE = "vocabulary.txt"
_FORM = 1
_BRANCHING, _LEVELS_SAID = 10, 6


def vocabulary_of(given: object) -> tuple[Path, str]:
    """The vocabulary that settings name, or ours as a file of the cache; and in words which it is.

    Args:
        given: a path, or None for ours.

    Raises:
        InputError: there is no such file, or the cache cannot be written.
    """
    if given is not None:
        path = Path(str(given)).expanduser()
        if not is_given(path):
            raise InputError(f"settings.vocabulary: {path}", "no such file", "correct the path")
        return path.resolve(), str(path)
    vocabulary = shipped_vocabulary()
    said = f"dual-slam-lab's own of {vocabulary.n_words} words, in DBoW2's text form"
    cache = FolderCache()
    digest = hashlib.sha256(VOCABULARY_FILE.read_bytes()).hexdigest()
    key = content_key({"form": _FORM, "vocabulary": digest})
    found = cache.find(key)
    if found is None:
        with cache.create(key) as folder:
            write_dbow2(vocabulary, folder / _FILE)
        found = cache.root / key
    return found / _FILE, said


def write_dbow2(vocabulary: Vocabulary, path: Path) -> None:
    """Write a vocabulary in the text form of DBoW2."""
    tree = vocabulary.tree
    parents = _parents(tree)
    octets = tree.descriptor.astype("<u8").view("uint8").reshape(len(tree.word), 32)
    lines = [f"{_BRANCHING} {_LEVELS_SAID} 0 0"]
    for node in range(1, len(tree.word)):
        word = int(tree.word[node])
        weight = float(tree.weight[word]) if word >= 0 else 0.0
        digits = " ".join(map(str, octets[node].tolist()))
        lines.append(f"{parents[node]} {int(word >= 0)} {digits} {weight:.6f}")
    # Without an end of line: the usual reader would take an empty line for a node.
    path.write_text("\n".join(lines), encoding="ascii")


def _parents(tree: Tree) -> list[int]:
    parents = [0] * len(tree.word)
    for node, (first, count) in enumerate(zip(tree.first_child, tree.n_children, strict=True)):
        for child in range(int(first), int(first) + int(count)):
            parents[child] = node
    return parents
