"""Mutations of files: bytes, types, sizes, order, missing, twice, other things in their place."""

from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from hostile_binary import archive, content, image, place, rows
from hostile_changes import UNLESS_OPTIONAL, UNLESS_SPARSE
from hostile_examples import Example
from hostile_systems import code
from hostile_text import table, tree
from hypothesis import strategies as st

_BY_SUFFIX = {
    ".txt": [table] * 4,
    ".csv": [table] * 4,
    ".yaml": [tree] * 4,
    ".json": [tree] * 4,
    ".png": [image],
    ".zip": [archive] * 2,
    ".sqlite": [rows] * 2,
    ".py": [code] * 12,
}


@dataclass(frozen=True)
class Mutation:
    """One change of one file.

    Attributes:
        kind: content, place, table, tree, image, archive, rows or code.
        what: the change, in words.
        path: the file, relative to the example.
        strict: what is read must stay the same, if it is not refused.
        apply: changes the file.
    """

    kind: str
    what: str
    path: str
    strict: bool
    apply: Callable[[Path], Any]

    def __repr__(self) -> str:
        return f"{self.path}: {self.what}"


@st.composite
def mutations(draw: Any, example: Example, folder: Path) -> Mutation:
    """A mutation of one file of an example that was written to a folder."""
    files = [str(p.relative_to(folder)) for p in sorted(folder.rglob("*")) if p.is_file()]
    files = [name for name in files if not _among(name, example.fixed)]
    # One image of a folder stands for all.
    images = {str(Path(name).parent): name for name in files if name.endswith(".png")}
    path = draw(
        st.sampled_from([name for name in files if not name.endswith(".png")] + sorted(images.values()))
    )
    kind = draw(st.sampled_from([content, place, *_BY_SUFFIX.get(Path(path).suffix, [])]))
    what, strict, apply = kind(draw, folder / path)
    excused = {UNLESS_OPTIONAL: example.optional + example.sparse, UNLESS_SPARSE: example.sparse}
    strict = strict or _among(path, example.ours)
    # Without its ledger an experiment begins anew, as its messages say.
    begun_anew = what == "missing" and path == "ledger.sqlite"
    if begun_anew or _among(path, example.free + excused.get(strict, ())):
        strict = False
    return Mutation(kind.__name__, what, path, bool(strict), apply)


def _among(path: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatch(path, pattern) for pattern in patterns)
