"""``dslab doctor`` and ``dslab warmup``: what the machine has, and the kernels."""

import os
import platform
from pathlib import Path

import typer

from dslab.experiments.cli.cache import size_text
from dslab.experiments.cli.console import err, print_error_line, print_facts, progress_bars
from dslab.experiments.kernel_cache import VARIABLE
from dslab.scenarios.errors import InputError


def doctor_command() -> None:
    """Report GL renderer, versions, cores, memory and caches; exit code 2 without OpenGL.

    Example: `dslab doctor`
    """
    import psutil

    from dslab import slam
    from dslab.experiments.runs.provenance import commit, usable_cores, versions
    from dslab.sim.cache import CACHE_DIR_VARIABLE, FolderCache
    from dslab.sim.rendering.gl_context import gl_info
    from dslab.sim.rendering.renderers import RENDERERS

    gl, gl_error = "none", None
    try:
        gl = "{renderer} ({version}, through {backend})".format(**gl_info())
    except InputError as error:
        gl_error = error
    memory, store = psutil.virtual_memory(), FolderCache()
    kernels = Path(os.environ.get(VARIABLE) or Path(str(slam.__file__)).parent)
    files = [f for pattern in ("*.nbi", "*.nbc") for f in kernels.rglob(pattern) if f.is_file()]
    print_facts(
        {
            "GL renderer": gl,
            "renderers": "none" if gl_error else ", ".join(map(_renderer, RENDERERS)),
            **versions(),
            "commit": commit() or "not a git work tree",
            "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
            "cores": f"{usable_cores()} usable of {os.cpu_count()}",
            "memory": f"{memory.total / 2**30:.1f} GiB, {memory.available / 2**30:.1f} free",
            "render cache": f"{store.root}, {size_text(store)}; {CACHE_DIR_VARIABLE} names another",
            "kernel cache": f"{kernels}, {len(files)} files, "
            f"{sum(f.stat().st_size for f in files) / 2**20:.0f} MiB",
        }
    )
    if gl_error is not None:
        print_error_line(f"error: {gl_error}")
        raise typer.Exit(2)


def _renderer(name: str) -> str:
    from dslab.sim.rendering.renderers import load_renderer

    try:
        load_renderer(name)
    except InputError as error:
        return f"{name} (not usable: {error.problem})"
    return name


def warmup_command() -> None:
    """Compile the kernels; later runs load them from the cache.

    Example: `dslab warmup`
    """
    from dslab.experiments.kernels import compile_kernels

    with progress_bars(kernels=False) as show:
        compile_kernels(show, again=True)
    err.print("kernels ready")
