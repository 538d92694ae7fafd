"""``dslab doctor``."""

import os
import platform
from pathlib import Path

import typer

from dslab.experiments.cli.cache import size_text
from dslab.experiments.cli.console import err, print_facts
from dslab.experiments.kernel_cache import VARIABLE
from dslab.scenarios.errors import InputError


def doctor_command() -> None:
    """Report GL renderer, versions, cores, memory and caches; exit code 2 without OpenGL.

    Example: `dslab doctor`
    """
    from dslab.experiments.runs.provenance import commit, usable_cores, versions

    gl, gl_error = _gl()
    print_facts(
        {
            "GL renderer": gl,
            "renderers": "none" if gl_error else _renderers(),
            **versions(),
            "commit": commit() or "not a git work tree",
            "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
            "cores": f"{usable_cores()} usable of {os.cpu_count()}",
            "memory": _memory(),
            "render cache": _render_cache(),
            "kernel cache": _kernel_cache(),
        }
    )
    if gl_error is not None:
        err.print(f"error: {gl_error}", soft_wrap=True)
        raise typer.Exit(2)


def _gl() -> tuple[str, InputError | None]:
    from dslab.sim.rendering.gl_context import gl_info

    try:
        info = gl_info()
    except InputError as error:
        return "none", error
    return f"{info['renderer']} ({info['version']}, through {info['backend']})", None


def _renderers() -> str:
    from dslab.sim.rendering.renderers import RENDERERS, load_renderer

    def state(name: str) -> str:
        try:
            load_renderer(name)
        except InputError as error:
            return f"{name} (not usable: {error.problem})"
        return name

    return ", ".join(map(state, RENDERERS))


def _memory() -> str:
    import psutil

    memory = psutil.virtual_memory()
    return f"{memory.total / 2**30:.1f} GiB, {memory.available / 2**30:.1f} free"


def _render_cache() -> str:
    from dslab.sim.cache import CACHE_DIR_VARIABLE, FolderCache

    store = FolderCache()
    return f"{store.root}, {size_text(store)}; {CACHE_DIR_VARIABLE} names another"


def _kernel_cache() -> str:
    from dslab import slam

    root = Path(str(slam.__file__)).parent
    if named := os.environ.get(VARIABLE):
        root = Path(named)
    files = [f for pattern in ("*.nbi", "*.nbc") for f in root.rglob(pattern) if f.is_file()]
    size = sum(f.stat().st_size for f in files)
    return f"{root}, {len(files)} files, {size / 2**20:.0f} MiB"
