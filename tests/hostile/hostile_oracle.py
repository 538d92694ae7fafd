"""What must hold at the end of every command, whatever it was given."""

import hashlib
import os
import re
import signal
import stat
from collections import Counter
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from hostile_examples import Example

PEAK_MB = 1500
_WORKING = ("experiment run", "batch", "experiment fuzz", "bench", "doctor", "warmup", "paper", "demo")
"""Commands that an input can set to long work: at the end of their time they are no hang."""
_REFUSAL = re.compile(r"error: [^\n]+: [^\n]+; [^\n]+\n")
_REFUSALS = re.compile(rf"({_REFUSAL.pattern})+(and \d+ more\n)?")
# What was noticed of the input before it was refused.
_NOTES = re.compile(r"^note: [^\n]+\n", re.MULTILINE)
_PARTIAL = re.compile(r"partial|unfinished|dslab|tmp")
_PASSING = ("-wal", "-shm", "-journal")


@dataclass(frozen=True)
class Ended:
    """The end of one command."""

    code: int
    out: str
    err: str
    wall_s: float
    peak_mb: float
    left: list[str]


def at_work(command: str, ended: Ended) -> bool:
    """The command was stopped in the midst of what it was told to do."""
    return ended.code == -signal.SIGALRM and command.startswith(_WORKING)


def filled(word: str, places: dict[str, str]) -> str:
    for name, path in places.items():
        word = word.replace(name, path)
    return word


def faults_of(ended: Ended, command: str = "") -> list[str]:
    """All that must not be at the end of a command, whatever it was given."""
    faults = []
    refusal = _REFUSALS if command.startswith("scenarios validate") else _REFUSAL
    if ended.code < 0:
        faults.append(f"ended by signal {-ended.code} after {ended.wall_s:.0f} s")
    elif ended.code not in (0, 2):
        faults.append(f"exit code {ended.code}: {_last_frames(ended.err)}")
    elif ended.code == 2 and not refusal.fullmatch(_NOTES.sub("", ended.err)):
        faults.append(f"not one line: {ended.err[:400]!r}")
    if "Traceback" in ended.err and ended.code in (0, 2):
        faults.append(f"a traceback: {_last_frames(ended.err)}")
    if ended.peak_mb > PEAK_MB:
        faults.append(f"{ended.peak_mb:.0f} MiB")
    if ended.left:
        faults.append(f"processes left: {ended.left}")
    return faults


def _last_frames(err: str) -> str:
    """The last place of a traceback in the lab, and its error."""
    places = re.findall(r'File "[^"]*?((?:experiments|scenarios|sim|slam)/[^"]+)", line (\d+), in (\w+)', err)
    place = " > ".join(f"{path}:{line} {name}" for path, line, name in places[-2:])
    return f"{place} | {err.strip().splitlines()[-1][:200] if err.strip() else ''}"


def debris(folder: Path, given: str, result: str | None, code: int) -> list[str]:
    """What is left beside a whole result, of this name if one may be there."""
    left = list((folder / "tmp").iterdir())
    left += [p for p in (folder / "out").iterdir() if p.name != result]
    left += [p for p in folder.rglob(".*") if p not in left and _PARTIAL.search(p.name)]
    if code != 0:
        left += [
            p for p in folder.iterdir() if p.name not in ("tmp", "out", given, "cache", "stdout", "stderr")
        ]
    return [f"left {p.relative_to(folder)}" for p in left]


def passing(name: str, example: Example) -> bool:
    """SQLite's files beside a ledger, and what a command may mend."""
    return name.endswith(_PASSING) or any(fnmatch(name, pattern) for pattern in example.mended)


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


def contents(folder: Path) -> dict[str, str]:
    """Every file of a folder with a digest of its content, the place aside; of special files, their kind."""
    found = {}
    for path in sorted(folder.rglob("*")):
        mode = path.lstat().st_mode
        if stat.S_ISREG(mode) and path.stat().st_size < 1 << 28:
            content = path.read_bytes().replace(os.fsencode(folder.parent), b"")
            found[str(path.relative_to(folder))] = hashlib.sha256(content).hexdigest()
        elif not stat.S_ISDIR(mode):
            found[str(path.relative_to(folder))] = f"{stat.S_IFMT(mode)}, {path.lstat().st_size} bytes"
    return found


def differing(one: dict[str, str], other: dict[str, str]) -> list[str]:
    return sorted(name for name in {*one, *other} if one.get(name) != other.get(name))


class Findings:
    """Counts of cases by kind and outcome, and each distinct fault with its first case."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[str, str, str]] = Counter()
        self.faults: dict[str, list[str]] = {}

    def add(self, about: str, kind: str, outcome: str, faults: list[str], case: str) -> None:
        self.counts[about, kind, "faulty" if faults else outcome] += 1
        for fault in faults:
            self.faults.setdefault(re.sub(r"\d{2,}", "#", fault), []).append(f"{case} -> {fault}")

    def text(self) -> str:
        return "\n".join(f"[{len(cases)}x] {cases[0]}" for cases in self.faults.values())
