"""Kernels are compiled once, before the first command that needs them, by a process for each core."""

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import numba
from numba.core import config

from dslab.experiments.runs.provenance import usable_cores
from dslab.slam.warmup import kernel_lines, read_kernels

_PACKAGES = ("dslab.sim", "dslab.slam")
_STEP = "compiling kernels, once"
_HELPER = "import sys; from dslab.experiments.kernels import _help; _help(int(sys.argv[1]))"
# Each process compiles parts of numba anew that no cache keeps: further ones would gain little.
_MOST_PROCESSES = 4


def compile_kernels(
    show: Callable[[str, int, int], None] = lambda step, done, total: None, again: bool = False
) -> None:
    """Compile the kernels of simulator and systems into numba's cache, unless a mark says they are there.

    Args:
        show: called with (step, number of kernels begun, total).
        again: look for each kernel, whatever the mark says.
    """
    if config.DISABLE_JIT:
        return
    mark, state = _mark()
    with suppress(OSError):
        if not mark.parent.is_dir() or (not again and mark.read_text(encoding="utf-8") == state):
            return
    kernels = read_kernels(*_PACKAGES)
    # The queue is a pipe with the numbers of the kernels: whoever reads one compiles it.
    queue, inlet = os.pipe()
    os.write(inlet, b"".join(number.to_bytes(2) for number in range(len(kernels))))
    os.close(inlet)
    processes = min(usable_cores(), _MOST_PROCESSES)
    helpers = [
        subprocess.Popen(
            [sys.executable, "-c", _HELPER, str(queue)],
            pass_fds=[queue],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            stderr=subprocess.DEVNULL,
        )
        for _ in range(processes - 1)
    ]
    try:
        for number in _taken(queue):
            show(_STEP, number, len(kernels))
            kernels[number].compile()
        if any(helper.wait() for helper in helpers):
            for kernel in kernels:
                kernel.compile()
    finally:
        for helper in helpers:
            helper.kill()
            helper.wait()
        os.close(queue)
    show(_STEP, len(kernels), len(kernels))
    with suppress(OSError):
        mark.write_text(state, encoding="utf-8")


def _taken(queue: int) -> Iterator[int]:
    while number := os.read(queue, 2):
        yield int.from_bytes(number)


def _help(queue: int) -> None:
    kernels = read_kernels(*_PACKAGES)
    for number in _taken(queue):
        kernels[number].compile()


def _mark() -> tuple[Path, str]:
    """File beside numba's cache, and what it says once all kernels are there as they are now.

    That is what numba's own index depends on: the times and sizes of sources, its version and the processor.
    """
    lines = [line for package in _PACKAGES for line in kernel_lines(package)]
    first = getattr(import_module(lines[-1][0]), lines[-1][1])
    root = Path(__file__).parents[1]
    modules = sorted({module.split(".", 1)[1] for module, *_ in lines})
    stats = [root.joinpath(*module.split(".")).with_suffix(".py").stat() for module in modules]
    stamps = [(stat.st_mtime_ns, stat.st_size) for stat in stats]
    known = (lines, stamps, numba.__version__, first.targetctx.codegen().magic_tuple())
    mark = Path(first.stats.cache_path) / f"kernels.{sys.implementation.cache_tag}"
    return mark, hashlib.sha256(repr(known).encode()).hexdigest()
