"""The kernels of a package: ``kernels.txt`` lists them, with the types of their arguments.

Compiling one that others call first spares it to be compiled with each of them.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.resources import files
from typing import Any

from numba import types
from numba.core.dispatcher import Dispatcher


@dataclass(frozen=True)
class Kernel:
    """A kernel and the one signature with which systems call it.

    Attributes:
        function: the dispatcher.
        arguments: its numba types.
    """

    function: Any
    arguments: tuple[types.Type, ...]

    def compile(self) -> None:
        """Load it from numba's cache, or compile it and store it there."""
        self.function.compile(self.arguments)


def kernel_lines(package: str) -> list[tuple[str, str, str]]:
    """Module, name and argument types of each kernel of a package, such as ``dslab.slam``, as text.

    Named tuples that are arguments of kernels come first, with the types of their fields.
    """
    lines = files(package).joinpath("kernels.txt").read_text(encoding="utf-8").splitlines()
    found = [re.fullmatch(r"(.+)\.(\w+)\((.*)\)", line) for line in lines]
    return [(f"{package}.{one[1]}", one[2], one[3]) for one in found if one]


def read_kernels(*packages: str) -> list[Kernel]:
    """All kernels of packages: those that others call before them, and of the others the longest first."""
    kernels = []
    for package in packages:
        names = {name: kind for name, kind in vars(types).items() if isinstance(kind, types.Type | type)}
        for module, name, text in kernel_lines(package):
            found = getattr(import_module(module), name)
            arguments = eval(f"({text},)", {}, names)
            if isinstance(found, type):
                names[name] = types.BaseTuple.from_types(arguments, found)
            else:
                kernels.append(Kernel(found, arguments))
    return sorted(kernels, key=lambda k: (_height(k.function), -len(k.function.py_func.__code__.co_code)))


@cache
def _height(function: Dispatcher) -> int:
    """Longest chain of calls from a kernel to one that calls none."""
    scope = function.py_func.__globals__
    called = map(scope.get, function.py_func.__code__.co_names)
    return max((1 + _height(inner) for inner in called if isinstance(inner, Dispatcher)), default=0)


def warm_up(progress: Callable[[str, int, int], None] | None = None) -> None:
    """Load every kernel of the systems into this process; those not in numba's cache are compiled.

    Args:
        progress: called with a message, the number of kernels done and the total.
    """
    kernels = read_kernels("dslab.slam")
    for done, kernel in enumerate(kernels):
        if progress:
            progress("loading kernels", done, len(kernels))
        kernel.compile()
    if progress:
        progress("loading kernels", len(kernels), len(kernels))
