"""What numba compiles while a test runs."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba import types
from numba.core import event


@contextmanager
def compiled() -> Iterator[list[str]]:
    """Kernels of ours that are compiled meanwhile, as lines of ``kernels.txt``."""
    lines: list[str] = []
    with event.install_recorder("numba:compile") as recorder:
        yield lines
    ours = (e.data for _, e in recorder.buffer if e.is_start)
    lines += [_line(**one) for one in ours if one["dispatcher"].py_func.__module__.startswith("dslab.")]


def _line(dispatcher: Any, args: tuple[types.Type, ...], **_: Any) -> str:
    place = dispatcher.py_func.__module__.split(".", 2)[2]
    return f"{place}.{dispatcher.py_func.__qualname__}({', '.join(map(_text, args))})"


def _text(kind: types.Type) -> str:
    if isinstance(kind, types.BaseNamedTuple):
        return kind.instance_class.__name__
    if isinstance(kind, types.Array) and kind.mutable and kind.layout in "CF":
        others = [":"] * (kind.ndim - 1)
        axes = [*others, "::1"] if kind.layout == "C" else ["::1", *others]
        return f"{kind.dtype}[{', '.join(axes)}]"
    return str(kind)
