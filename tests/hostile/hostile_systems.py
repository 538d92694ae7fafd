"""Systems that are not ours, a class and a program, and what such code may do to the lab."""

import sys
from pathlib import Path
from typing import Any

from hostile_changes import Change
from hostile_sequences import tum
from hypothesis import strategies as st

_CLASS = """
import os, sys, threading, time
import numpy as np

class Own:
    def __init__(self, camera, seed):
        self.frames, self.events = 0, []

    def process(self, image, stamp_s):
        self.frames += 1
        T = np.eye(4)
        T[0, 3] = 0.1 * self.frames
        #EDIT
        return T
"""
_PROGRAM = """
import os, pathlib, signal, subprocess, sys, time

seq, out = map(pathlib.Path, sys.argv[1:3])
listed = [line.split()[0] for line in (seq / "rgb.txt").read_text().splitlines() if line[0] != "#"]
rows = [f"{stamp} {0.1 * n} 0 0 0 0 0 1" for n, stamp in enumerate(listed)]
file = out / "trajectory.txt"
#EDIT
file.write_text("\\n".join(rows) + "\\n")
"""
_DETACHED = "os.fork() == 0 and (os.setsid(), os.fork() == 0 and time.sleep(60), os._exit(0))"
_BOTH = (
    "raise SystemExit", "raise SystemExit('words')", "sys.exit(3)", "os._exit(0)", "raise BaseException",
    "raise Exception('\\n\\x1b[31m[/]\\udcff')", "raise MemoryError", "raise GeneratorExit", "x = 1 / 0",
    "class Bad(Exception):\n        __str__ = None\n    raise Bad", "sys.setrecursionlimit(100)",
    "print('x' * 5_000_000)", "print('\\x1b[2J', file=sys.stderr)", "sys.stdout.close()", "os.chdir('/')",
    "os.environ.clear()", "time.sleep(0.5)", "f = lambda: f()\n    f()", "sys.modules.clear()",
)  # fmt: skip
_OF_CLASSES = (
    "return 10**401", "return 'x'", "return [[1]]", "return T * np.nan", "return T * 0", "return iter(())",
    "return object()", "return T.astype(complex)", "return T.astype(str)", "return T * 1e300", "image[:] = 0",
    "return np.ma.masked_array(T, True)", "self.events.append(('x',))",
    "self.events.append((stamp_s, 'lost'))",
    "self.events.append((10**401, 'x'))", "self.events = 3", "self.finish = lambda: [1]", "del self.events",
    "self.finish = lambda: 1 / 0", "threading.Thread(target=time.sleep, args=(3,), daemon=True).start()",
    "np.seterr(all='raise')", "type(self).process = None", "self.__dict__.clear()",
)  # fmt: skip
_OF_PROGRAMS = (
    _DETACHED, f"{_DETACHED}; os._exit(1)", "subprocess.Popen(['sleep', '60'], start_new_session=True)",
    "[p.unlink() for p in seq.rglob('*') if p.is_file()]", "seq.rename(out / 'moved')", "os.umask(0)",
    "file.mkdir()", "file.symlink_to('/dev/zero'); os._exit(0)", "os.mkfifo(file); os._exit(0)", "rows = []",
    "file.symlink_to(file.name); os._exit(0)", "file.write_bytes(bytes(range(256))); os._exit(0)",
    "os.truncate(os.open(file, os.O_CREAT | os.O_RDWR), 1 << 30); os._exit(0)", "os.killpg(0, 9)",
    "os.kill(os.getpid(), 11)", "signal.signal(15, signal.SIG_IGN); time.sleep(60)", "rows.reverse()",
    "rows[2] = rows[2].replace('0 0 1', '0 0 0')", "rows[2] = 'nan ' + rows[2]", "rows[1] = '9' * 401",
    "rows += rows", "rows = ['1e9' + row for row in rows]", "x = bytearray(10**9); time.sleep(9)",
    "out.chmod(0); os._exit(0)", "print('\\0' * 99, flush=True)", "rows[0] = '# [/] \\x1b[31m'",
)  # fmt: skip


def own_class(folder: Path) -> None:
    folder.mkdir(parents=True)
    tum(folder / "tum")
    (folder / "own.py").write_text(_CLASS)


def program(folder: Path) -> None:
    folder.mkdir(parents=True)
    tum(folder / "tum")
    write_program(folder / "systems")


def write_program(folder: Path, edit: str = "") -> None:
    """Write a program and its description."""
    folder.mkdir()
    (folder / "program.py").write_text(_PROGRAM.replace("#EDIT", edit))
    (folder / "copy.yaml").write_text(
        f"about: a copy\ncommand: {sys.executable} {{here}}/program.py {{sequence}} {{out}}\n"
        "trajectory: trajectory.txt\nlimits: {start_s: 3, slow_down: 1, memory_mb: 500}\n"
    )


def long_program(folder: Path) -> None:
    """Write one that leaves a child in a session of its own, and works for long."""
    write_program(folder, f"{_DETACHED}; time.sleep(4)")


def code(draw: Any, path: Path) -> Change:
    """Other code in the midst of a class or a program."""
    is_class = path.name == "own.py"
    line = draw(st.sampled_from(_BOTH + (_OF_CLASSES if is_class else _OF_PROGRAMS)))
    inside = line.replace("\n", "\n    ") if is_class else line.replace("\n    ", "\n")
    return line, False, lambda path: path.write_text(path.read_text().replace("#EDIT", inside))
