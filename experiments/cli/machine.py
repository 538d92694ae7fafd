"""What the machine refuses a command, wherever in it: one line."""

import errno
import os

from dslab.scenarios.errors import InputError, MachineError

_HERE = "this machine"
_NO_MEMORY = ("failed to map segment", "Insufficient memory", "Cannot allocate memory", "bad_alloc")
"""How libraries say it that raise no MemoryError."""
_REFUSED = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EFBIG: "raise `ulimit -f`",
    errno.EMFILE: "raise `ulimit -n`",
    errno.ENFILE: "end other programs",
    errno.EAGAIN: "raise `ulimit -u`",
    errno.ENOMEM: "raise `ulimit -v`, or take fewer or smaller frames",
    errno.EIO: "check the disk",
    errno.EROFS: "choose a folder elsewhere",
}


def check_folder() -> None:
    """Raise InputError if the present folder is gone, which Python ends with a traceback at."""
    try:
        os.getcwd()
    except OSError as error:
        problem = f"cannot be used ({error.strerror})"
        raise InputError("the present folder", problem, "change to one that exists") from None


def keep_from_others() -> None:
    """Where no mask is set, let only the owner write what is made by this process and its children."""
    if not (mask := os.umask(0o022)):
        return
    os.umask(mask)


def refused(error: BaseException) -> InputError | None:
    """The line for what the machine has refused; None for any other error."""
    said = f"{error} {error.__context__}"
    if isinstance(error, MemoryError) or any(words in said for words in _NO_MEMORY):
        return MachineError(_HERE, "has no memory left", _REFUSED[errno.ENOMEM])
    if isinstance(error, OSError) and error.errno in _REFUSED:
        where = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else _HERE
        return MachineError(where, (error.strerror or "fails").lower(), _REFUSED[error.errno])
    return None
