"""Kernels compile where neither the installation nor the home folder can be written."""

import os
import tempfile
from pathlib import Path

import pytest

from dslab.experiments import kernel_cache
from dslab.experiments.kernel_cache import VARIABLE, choose_kernel_cache


@pytest.fixture
def read_only(monkeypatch, tmp_path):
    """An environment in which numba finds no folder, and its temporary folder."""
    file = tmp_path / "file"
    file.write_text("")
    kept = {k: v for k, v in os.environ.items() if k != VARIABLE}
    monkeypatch.setattr(os, "environ", kept)
    # A file in the place of a folder: unlike permissions, it stops root as well.
    monkeypatch.setattr(kernel_cache, "_numbas_own", lambda: [file / "__pycache__", file / "numba"])
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_private_folder_on_the_temporary_disk_is_taken_with_one_line_the_first_time(read_only, capsys):
    choose_kernel_cache()
    folder = read_only / f"dslab-kernels-{os.getuid()}"
    assert os.environ[VARIABLE] == str(folder) and folder.stat().st_mode & 0o777 == 0o700
    assert capsys.readouterr().err.count("\n") == 1
    del os.environ[VARIABLE]
    choose_kernel_cache()
    assert os.environ[VARIABLE] == str(folder) and capsys.readouterr().err == ""


@pytest.mark.parametrize("trap", ["open to others", "a link", "a file"])
def test_a_folder_that_others_could_write_is_not_taken(read_only, trap):
    folder = read_only / f"dslab-kernels-{os.getuid()}"
    if trap == "open to others":
        folder.mkdir()
        folder.chmod(0o777)
    elif trap == "a link":
        folder.symlink_to(read_only)
    else:
        folder.write_text("")
    choose_kernel_cache()
    taken = Path(os.environ[VARIABLE])
    assert taken != folder and taken.parent == read_only and taken.stat().st_mode & 0o777 == 0o700


def test_what_numba_can_write_or_the_user_has_set_stays(read_only, monkeypatch):
    os.environ[VARIABLE] = "mine"
    choose_kernel_cache()
    assert os.environ[VARIABLE] == "mine"
    del os.environ[VARIABLE]
    monkeypatch.setattr(kernel_cache, "_numbas_own", lambda: [read_only / "own"])
    choose_kernel_cache()
    assert VARIABLE not in os.environ
