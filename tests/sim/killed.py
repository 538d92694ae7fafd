"""A process that is killed at work, for the tests of what it leaves."""

import signal
import subprocess
import sys
from pathlib import Path

_PROGRAM = """
import os, sys
from pathlib import Path
from dslab.sim.unfinished import unfinished_folder
with unfinished_folder(Path(sys.argv[1]), sys.argv[2]) as folder:
    (folder / "x").write_text("half")
    os.kill(os.getpid(), 9)
"""


def killed_in_a_folder(parent: Path, prefix: str) -> None:
    """Run a process that makes an unfinished folder and is killed in it."""
    ended = subprocess.run([sys.executable, "-c", _PROGRAM, str(parent), prefix], check=False, timeout=60)
    assert ended.returncode == -signal.SIGKILL
