"""A cache of folders by content hash: atomic, checksummed, safe for several processes."""

import hashlib
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import open_file, read_json
from dslab.sim.unfinished import is_held, sweep, unfinished_folder

ContentT = TypeVar("ContentT")

CACHE_DIR_VARIABLE = "DSLAB_CACHE_DIR"
MAX_BYTES = 20 * 10**9
"""Size to which the cache is cut back."""
_MANIFEST = "manifest.json"
UNFINISHED = ".unfinished-"

_log = logging.getLogger(__name__)


def default_cache_dir() -> Path:
    """``DSLAB_CACHE_DIR``, else ``dual-slam-lab`` in the platform's cache folder."""
    if named := os.environ.get(CACHE_DIR_VARIABLE):
        return Path(named).expanduser()
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "dual-slam-lab"


def content_key(content: Any) -> str:
    """Hash of JSON-like content; equal content gives equal keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class CorruptEntryError(Exception):
    """An entry of the cache whose content is not what was written."""


@dataclass(frozen=True)
class Entry:
    """A finished folder of the cache.

    Attributes:
        path: the folder.
        size_bytes: of its files.
        used_s: when it was made or last found, seconds since the epoch.
    """

    path: Path
    size_bytes: int
    used_s: float


class FolderCache:
    """Finished folders by key.

    An entry appears under its name only when it is complete, by a rename; its manifest holds the size and
    SHA-256 of every file. The entries used longest ago are dropped beyond ``max_bytes``.

    Args:
        root: folder of the cache, made when needed; None for ``default_cache_dir()``.
        max_bytes: size to which the cache is cut back after an entry has been added.
    """

    def __init__(self, root: Path | None = None, max_bytes: int = MAX_BYTES) -> None:
        self.root = root or default_cache_dir()
        self._max_bytes = max_bytes

    def find(self, key: str) -> Path | None:
        """Return the folder of a sound entry, else None; drop a corrupt one."""
        entry = self.root / key
        if not entry.is_dir():
            return None
        if fault := _fault(entry):
            self.drop(entry, fault)
            return None
        with suppress(OSError):  # a read-only cache can still be read
            os.utime(entry / _MANIFEST)
        return entry

    def load(self, key: str, read: Callable[[Path], ContentT]) -> ContentT | None:
        """What a sound entry holds; None without one. One that ``read`` finds corrupt is dropped."""
        entry = self.find(key)
        if entry is None:
            return None
        try:
            return read(entry)
        except CorruptEntryError as fault:
            self.drop(entry, str(fault))
            return None

    def entries(self) -> list[Entry]:
        """Every entry, those used longest ago first; other folders and files are none."""
        try:
            paths = [path for path in self.root.iterdir() if (path / _MANIFEST).is_file()]
        except OSError:
            return []
        found = (Entry(path, _bytes(path), _modified_s(path / _MANIFEST)) for path in paths)
        return sorted(found, key=lambda entry: entry.used_s)

    def clean(self, unused_for_s: float = 0.0) -> tuple[list[Entry], list[Entry]]:
        """Delete entries, and what killed processes have left.

        Args:
            unused_for_s: only those that were last used so long ago.

        Returns:
            The entries deleted, and those kept because a process uses their frames.
        """
        old = [entry for entry in self.entries() if entry.used_s <= time.time() - unused_for_s]
        used = [entry for entry in old if any(map(is_held, _files(entry.path)))]
        deleted = [entry for entry in old if entry not in used]
        for entry in deleted:
            _discard(entry.path)
        sweep(self.root, UNFINISHED)
        return deleted, used

    def drop(self, entry: Path, fault: str) -> None:
        """Delete a corrupt entry, with a warning that names the fault."""
        _log.warning("cache entry %s is corrupt (%s): rendering it again", entry, fault)
        _discard(entry)

    @contextmanager
    def create(self, key: str) -> Iterator[Path]:
        """Yield an empty folder, which becomes the entry when the block ends without an error.

        If another process has finished the same entry meanwhile, that one stays.

        Raises:
            InputError: the cache folder cannot be written or the disk is full.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            with unfinished_folder(self.root, UNFINISHED) as unfinished:
                yield unfinished
                _write_manifest(unfinished)
                self._publish(unfinished, self.root / key)
        except OSError as error:
            raise self._unusable(error) from error
        self._cut_back(keep=key)

    def _publish(self, unfinished: Path, entry: Path) -> None:
        try:
            unfinished.rename(entry)
        except OSError:
            if not entry.is_dir():
                raise

    def _unusable(self, error: OSError) -> InputError:
        problem = f"the cache cannot be written ({error.strerror or error})"
        return InputError(
            str(self.root), problem, f"free space or set {CACHE_DIR_VARIABLE} to another folder"
        )

    def _cut_back(self, keep: str) -> None:
        entries = self.entries()
        total_bytes = sum(entry.size_bytes for entry in entries)
        for entry in entries:
            if total_bytes <= self._max_bytes:
                return
            if entry.path.name != keep:
                total_bytes -= entry.size_bytes
                _discard(entry.path)


def _write_manifest(folder: Path) -> None:
    files = {f.name: {"bytes": f.stat().st_size, "sha256": _sha256(f)} for f in _files(folder)}
    (folder / _MANIFEST).write_text(json.dumps({"files": files}, indent=1))


def _fault(entry: Path) -> str:
    """Fault of an entry, empty if it is sound."""
    try:
        files = read_json(entry / _MANIFEST, dict).get("files")
        found = {path.name for path in entry.iterdir()} - {_MANIFEST}
        if not isinstance(files, dict) or set(files) != found:
            return "its files are not those of its manifest"
        for name, expected in files.items():
            size_bytes = (entry / name).stat().st_size
            if not isinstance(expected, dict) or size_bytes != expected.get("bytes"):
                return f"{name} has the wrong size"
            if _sha256(entry / name) != expected.get("sha256"):
                return f"{name} has the wrong checksum"
    except (OSError, InputError) as error:
        return str(error)
    return ""


def _sha256(path: Path) -> str:
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file())


def _bytes(entry: Path) -> int:
    """Size of an entry; 0 if another process is deleting it."""
    try:
        return sum(path.stat().st_size for path in _files(entry))
    except OSError:
        return 0


def _discard(entry: Path) -> None:
    """Rename the entry in one step, then delete it."""
    with suppress(OSError), unfinished_folder(entry.parent, UNFINISHED) as away:  # another may be faster
        entry.rename(away / entry.name)


def _modified_s(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
