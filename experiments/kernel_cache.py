"""A place for compiled kernels where neither the installation nor the home folder can be written.

numba keeps them beside their source, else in the cache of the user, else it raises. The choice is made before
numba is imported, and in the environment, so that worker processes follow it.
"""

import os
import stat
import sys
import tempfile
from pathlib import Path

VARIABLE, _LOCATORS = "NUMBA_CACHE_DIR", "NUMBA_CACHE_LOCATOR_CLASSES"


def choose_kernel_cache() -> None:
    """Where numba could not keep kernels, point it to a folder on the temporary disk, else to none."""
    if os.environ.get(VARIABLE) or os.environ.get(_LOCATORS) or any(map(_writable, _numbas_own())):
        return
    folder, is_new = _private_folder()
    if folder is None:
        os.environ[_LOCATORS] = "dslab.experiments.uncached_kernels.NoCache"
        return
    os.environ[VARIABLE] = str(folder)
    if is_new:
        say(f"kernels are kept in {folder}: neither the installation nor the home folder can be written")


def say(line: str) -> None:
    """Print a line on stderr, in the first process only."""
    from multiprocessing import parent_process

    if parent_process() is None and sys.stderr is not None:
        print(line, file=sys.stderr)


def _numbas_own() -> list[Path]:
    package = Path(__file__).parent
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    return [package / "__pycache__", home / "numba"]


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


def _private_folder() -> tuple[Path | None, bool]:
    """A folder of this user alone, as kernels are code; None if there is none. And whether it is new."""
    try:
        folder = Path(tempfile.gettempdir()) / f"dslab-kernels-{os.getuid()}"
        is_new = not os.path.lexists(folder)
        folder.mkdir(mode=0o700, exist_ok=True)
        state = folder.lstat()
    except OSError:
        return None, False
    private = stat.S_ISDIR(state.st_mode) and not stat.S_IMODE(state.st_mode) & 0o077
    return (folder, is_new) if private and state.st_uid == os.getuid() else (None, False)
