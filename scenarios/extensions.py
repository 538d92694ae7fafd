"""Extensions of the lab that are registered at run time, as far as cached results depend on them."""

import hashlib
import inspect
import uuid
from typing import Any

_digests: dict[str, str] = {}


def note_extension(name: str, implementation: Any) -> None:
    """Remember what implements an extension, so that no frames of another version are taken for its own.

    Args:
        name: part and kind, such as ``degradation: ghosting``.
        implementation: a class, a function or an instance of a class.
    """
    _digests[name] = source_digest(implementation)


def extension_digests() -> dict[str, str]:
    """Digests of the registered extensions' sources, by name."""
    return dict(sorted(_digests.items()))


def source_digest(implementation: Any) -> str:
    """Hash of the module that holds an implementation; unique in each process where there is no source."""
    is_code = inspect.isclass(implementation) or inspect.isroutine(implementation)
    code = implementation if is_code else type(implementation)
    try:
        text = inspect.getsource(inspect.getmodule(code) or code)
    except (OSError, TypeError):
        try:
            text = inspect.getsource(code)
        except (OSError, TypeError):
            text = uuid.uuid4().hex
    return hashlib.sha256(text.encode()).hexdigest()[:16]
