"""Kernels are listed once each, and compiled once, before the first command that needs them."""

import fcntl
import pkgutil
import struct
import termios
import time
from importlib import import_module

import numba
import pytest
from numba.core.dispatcher import Dispatcher

from dslab import sim, slam
from dslab.experiments import kernels
from dslab.experiments.cli.console import progress_bars
from dslab.experiments.cli.units import unit_progress
from dslab.experiments.kernels import compile_kernels
from dslab.slam.warmup import Kernel, read_kernels

# The training of a vocabulary is no part of a system.
NOT_OF_SYSTEMS = "dslab.slam.places.training"


def test_every_kernel_stands_in_a_table_once_after_those_it_calls():
    listed = [kernel.function for kernel in read_kernels("dslab.sim", "dslab.slam")]
    assert len(set(listed)) == len(listed)
    found = {
        function
        for package in (sim, slam)
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if module.name != NOT_OF_SYSTEMS
        for function in vars(import_module(module.name)).values()
        if isinstance(function, Dispatcher) and function.targetoptions.get("inline", "never") == "never"
    }
    assert found == set(listed)
    for place, function in enumerate(listed):
        scope = function.py_func.__globals__
        called = {id(scope.get(name)) for name in function.py_func.__code__.co_names}
        assert not called & set(map(id, listed[place:]))


@numba.njit
def doubled(x):
    return 2 * x


@pytest.fixture
def few(monkeypatch, tmp_path):
    """Three kernels instead of all, no further process, and a folder for the mark; those compiled."""
    done = []

    class Counted(Kernel):
        def compile(self):
            done.append(self)

    some = [Counted(doubled, (numba.types.int64,))] * 3
    monkeypatch.setattr(kernels, "read_kernels", lambda *packages: some)
    monkeypatch.setattr(kernels, "_mark", lambda: (tmp_path / "mark", "as they are"))
    monkeypatch.setattr(kernels, "usable_cores", lambda: 1)
    return done


def test_kernels_are_compiled_once_and_again_after_a_change(few, monkeypatch, tmp_path):
    told = []
    compile_kernels(lambda step, done, total: told.append((done, total)))
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)] and len(few) == 3
    compile_kernels()
    assert len(few) == 3
    compile_kernels(again=True)
    assert len(few) == 6
    monkeypatch.setattr(kernels, "_mark", lambda: (tmp_path / "mark", "changed"))
    compile_kernels()
    assert len(few) == 9


def test_without_a_place_for_kernels_none_are_compiled_beforehand(few, monkeypatch, tmp_path):
    monkeypatch.setattr(kernels, "_mark", lambda: (tmp_path / "absent" / "mark", ""))
    compile_kernels(again=True)
    assert few == []


def test_a_process_beside_takes_from_the_same_queue_and_what_a_failed_one_took_is_compiled(few, monkeypatch):
    monkeypatch.setattr(kernels, "usable_cores", lambda: 2)
    monkeypatch.setattr(kernels, "_HELPER", "import os, sys; os.read(int(sys.argv[1]), 2); sys.exit(1)")
    monkeypatch.setattr(kernels, "_taken", _late(kernels._taken))
    compile_kernels()
    assert len(few) == 2 + 3


def _late(taken):
    """Taken from the queue only once the other process has taken one."""

    def after(queue):
        while struct.unpack("i", fcntl.ioctl(queue, termios.FIONREAD, b"\0" * 4))[0] == 6:
            time.sleep(0.01)
        yield from taken(queue)

    return after


def test_the_mark_names_the_sources_as_they_are(monkeypatch):
    mark, state = kernels._mark()
    assert mark.parent.is_dir() and kernels._mark() == (mark, state)
    monkeypatch.setattr(numba, "__version__", "another")
    assert kernels._mark()[1] != state


def test_what_runs_slam_compiles_first_with_its_bar(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(kernels, "compile_kernels", asked.append)
    with progress_bars() as show:
        assert asked == [show]
    with progress_bars(kernels=False):
        pass
    with unit_progress("units", tmp_path):
        pass
    assert len(asked) == 2
