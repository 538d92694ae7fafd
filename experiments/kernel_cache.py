"""A place for compiled kernels where neither the installation nor the home folder can be written.

numba keeps them beside their source, else in the cache of the user, else it raises. The choice is made before
numba is imported, and in the environment, so that worker processes follow it.
"""

import os
import stat
import sys
import tempfile
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def choose_kernel_cache() -> None:
    """Where numba could not keep kernels, point it to a folder on the temporary disk; say so if it is new."""
    if os.environ.get(VARIABLE) or any(map(_writable, _numbas_own())):
        return
    folder = Path(tempfile.gettempdir()) / f"dslab-kernels-{os.getuid()}"
    is_new = not os.path.lexists(folder)
    if is_new:
        folder.mkdir(mode=0o700)
    state = folder.lstat()
    private = stat.S_ISDIR(state.st_mode) and not stat.S_IMODE(state.st_mode) & 0o077
    if not private or state.st_uid != os.getuid():  # kernels are code: others must not write there
        folder, is_new = Path(tempfile.mkdtemp(prefix="dslab-kernels-")), True
    os.environ[VARIABLE] = str(folder)
    if is_new and sys.stderr is not None:
        problem = "neither the installation nor the home folder can be written"
        print(f"kernels are kept in {folder}: {problem}", file=sys.stderr)


def _numbas_own() -> list[Path]:
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    return [Path(__file__).parent / "__pycache__", home / "numba"]


def _writable(folder: Path) -> bool:
    """True if numba will find a folder writable; a home that is not known is none."""
    if not folder.is_absolute():
        return False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
