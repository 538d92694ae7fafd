"""The warm-up compiles the simulator's kernels, so that no rendering has to."""

import pkgutil
from importlib import import_module

import pytest

from dslab import sim
from dslab.sim.warmup import warm_up

# For images of fisheye lenses, which few scenarios have.
LATER = {"undistort_equidistant"}
# Called by another kernel only.
INNER = {"row_shifts"}


@pytest.mark.slow
def test_every_kernel_is_compiled():
    warm_up()
    modules = [import_module(found.name) for found in pkgutil.walk_packages(sim.__path__, "dslab.sim.")]
    kernels = {
        name: kernel.signatures
        for module in modules
        for name, kernel in vars(module).items()
        if hasattr(kernel, "signatures") and kernel.__module__ == module.__name__
    }
    # Kernels with an underscore are called by others and compiled with them.
    asked = {name: compiled for name, compiled in kernels.items() if not name.startswith("_")}
    assert len(asked) > 10
    assert {name for name, compiled in asked.items() if not compiled} == LATER | INNER
