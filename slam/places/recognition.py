"""Place recognition: find keyframes that may show the same place as an image.

Source: Galvez-Lopez, Tardos, "Bags of Binary Words for Fast Place Recognition in Image Sequences", 2012;
candidates as in Mur-Artal, Montiel, Tardos, "ORB-SLAM", 2015, sections III-E, V-C and VII-A.
"""

import json
import zipfile
import zlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from dslab.slam.core.snapshot import Immutable
from dslab.slam.map.map import MIN_SHARED, Map
from dslab.slam.places import _vocabulary_kernels as kernels
from dslab.slam.places._vocabulary_kernels import InvertedFile, Tree

VOCABULARY_FILE = Path(__file__).parent / "data" / "vocabulary.npz"

_TOTAL_SHARE = 0.75
"""Of the best: section III-E."""


@dataclass(frozen=True)
class BowVector(Immutable):
    """The bag of words of one image.

    Attributes:
        words: (m,) int32 words that occur, increasing.
        weights: (m,) float64 their weights (term frequency times inverse document frequency), sum 1.
    """

    words: np.ndarray
    weights: np.ndarray

    def score(self, other: "BowVector") -> float:
        """Similarity of two images: 1 for equal bags of words, 0 without common words."""
        _, mine, theirs = np.intersect1d(self.words, other.words, assume_unique=True, return_indices=True)
        return float(np.minimum(self.weights[mine], other.weights[theirs]).sum())


_EMPTY_BAG = BowVector(np.empty(0, np.int32), np.empty(0))


class Vocabulary(Immutable):
    """A tree of ORB descriptors whose leaves are words.

    Attributes:
        tree: its arrays.
        provenance: description of the training data.
    """

    def __init__(self, tree: Tree, provenance: dict) -> None:
        self.tree = tree
        self.provenance = provenance

    @property
    def n_words(self) -> int:
        """Number of words."""
        return len(self.tree.weight)

    def transform(self, descriptors: np.ndarray) -> BowVector:
        """Compute the bag of words of an image.

        Args:
            descriptors: (n, 4) uint64.
        """
        word = kernels.descend(self.tree, np.ascontiguousarray(descriptors))
        weight = np.bincount(word, minlength=self.n_words) * self.tree.weight
        words = np.flatnonzero(weight)
        weights = weight[words] / weight[words].sum() if len(words) else np.empty(0)
        return BowVector(words.astype(np.int32), weights)

    def save(self, path: Path) -> None:
        """Write the vocabulary as an .npz file; the same vocabulary gives the same bytes."""
        arrays = self.tree._replace(weight=self.tree.weight.astype(np.float32))._asdict()
        np.savez_compressed(path, provenance=np.array(json.dumps(self.provenance)), **arrays)

    @staticmethod
    def load(path: Path) -> "Vocabulary":
        """Read a vocabulary written by :meth:`save`.

        Raises:
            ValueError: the file is not a vocabulary.
        """
        if not zipfile.is_zipfile(path):
            raise ValueError(f"{path} is not a vocabulary: no archive")
        try:
            with np.load(path) as data:
                tree = Tree(*(data[name] for name in Tree._fields))
                provenance = json.loads(str(data["provenance"]))
        except (KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise ValueError(f"{path} is not a vocabulary: {error}") from error
        if not isinstance(provenance, dict):
            raise ValueError(f"{path} is not a vocabulary: its provenance is no mapping")
        return Vocabulary(tree._replace(weight=tree.weight.astype(np.float64)), provenance)


@cache
def shipped_vocabulary() -> Vocabulary:
    """Vocabulary of the package, loaded once."""
    return Vocabulary.load(VOCABULARY_FILE)


class KeyframeDatabase:
    """Keyframes of one map, indexed by visual words.

    The database follows its map: a query for candidates first adds new keyframes and removes culled ones.

    Args:
        map_: the map.
        vocabulary: the visual words; the package's vocabulary if None.
    """

    def __init__(self, map_: Map, vocabulary: Vocabulary | None = None) -> None:
        self.map = map_
        self.vocabulary = vocabulary or shipped_vocabulary()
        self._bows: list[BowVector] = []
        self._filed: list[bool] = []
        self._foreseen: dict[int, BowVector] = {}
        n = self.vocabulary.n_words
        self._file = InvertedFile(
            np.zeros(n, np.int64), np.zeros(n, np.int32), np.zeros(n, np.int32),
            np.empty(0, np.int32), np.empty(0),
        )  # fmt: skip
        self._end = 0

    def __len__(self) -> int:
        """Number of keyframes in the database."""
        return sum(self._filed)

    def bow(self, keyframe: int) -> BowVector:
        """Bag of words of a keyframe in the database."""
        return self._bows[keyframe]

    def foresee(self, bows: dict[int, BowVector]) -> None:
        """Take over bags of words, by row, that were computed for keyframes not yet in the database."""
        self._foreseen |= bows

    def add(self) -> None:
        """Add the next keyframe of the map."""
        keyframe = len(self._bows)
        bow = self._foreseen.pop(keyframe, None)
        if bow is None:
            bow = self.vocabulary.transform(self.map.features(keyframe).descriptors)
        self._reserve(kernels.room_needed(self._file, bow.words))
        self._end = kernels.file_words(self._file, self._end, keyframe, bow.words, bow.weights)
        self._bows.append(bow)
        self._filed.append(True)

    def erase(self, keyframe: int) -> None:
        """Remove a keyframe, if it is in the database."""
        if self._filed[keyframe]:
            kernels.remove_words(self._file, keyframe, self._bows[keyframe].words)
            self._filed[keyframe] = False
            self._bows[keyframe] = _EMPTY_BAG

    def update(self) -> None:
        """Add the map's new keyframes, remove the culled ones."""
        for _ in range(len(self._bows), self.map.n_keyframes):
            self.add()
        bad = self.map.arrays.kf_bad[: self.map.n_keyframes]
        for k in np.flatnonzero(bad & np.array(self._filed, np.bool_)):
            self.erase(int(k))

    def query(self, bow: BowVector) -> tuple[np.ndarray, np.ndarray]:
        """Compare an image with every keyframe in the database.

        Returns:
            Per row: (n,) int32 number of common words, (n,) float64 score as :meth:`BowVector.score`.
        """
        return kernels.look_up(self._file, len(self._bows), bow.words, bow.weights)

    def relocalization_candidates(self, bow: BowVector) -> list[int]:
        """Keyframes that may show the same place as an image, best first."""
        self.update()
        common, score = self.query(bow)
        return self._best_groups(score, common > 0)

    def loop_candidates(self, keyframe: int) -> list[int]:
        """Keyframes, not neighbours, that may show the same place as this one, best first.

        A candidate is at least as similar to the keyframe as its least similar neighbour. Without neighbours
        there are no candidates.
        """
        self.update()
        neighbours = self.map.neighbours(keyframe, self.map.n_keyframes)
        if not len(neighbours):
            return []
        common, score = self.query(self._bows[keyframe])
        elsewhere = common > 0
        elsewhere[neighbours] = False
        elsewhere[keyframe] = False
        return self._best_groups(score, elsewhere & (score >= score[neighbours].min()))

    def _best_groups(self, score: np.ndarray, possible: np.ndarray) -> list[int]:
        """Best keyframe of each group of connected keyframes whose scores add up to nearly the most."""
        shared = self.map.arrays.covisibility
        total, best = kernels.score_groups(possible, score, shared, np.int64(MIN_SHARED))
        good = np.flatnonzero(total > _TOTAL_SHARE * total.max(initial=0.0))
        good = good[np.argsort(-total[good], kind="stable")]
        return list(dict.fromkeys(best[good].tolist()))

    def _reserve(self, entries: int) -> None:
        """Reserve room for ``entries`` more entries."""
        f = self._file
        have, need = len(f.keyframe), self._end + entries
        if need > have:
            more = max(need, 2 * have) - have
            self._file = f._replace(
                keyframe=np.concatenate([f.keyframe, np.empty(more, np.int32)]),
                weight=np.concatenate([f.weight, np.empty(more)]),
            )
