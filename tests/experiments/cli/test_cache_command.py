"""``dslab cache``: folder, size, cap, and cleaning."""

import os
import time

import pytest

from dslab.scenarios.errors import InputError
from dslab.sim.cache import FolderCache


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "cache"))
    for name, days in (("new", 0.1), ("old", 9)):
        with FolderCache().create(name) as folder:
            (folder / "gray.npy").write_bytes(bytes(10**7))
        os.utime(tmp_path / "cache" / name / "manifest.json", (time.time() - days * 86400,) * 2)
    return tmp_path / "cache"


def test_it_shows_folder_size_cap_and_ages(dslab, cache):
    code, out, _ = dslab("cache")
    assert code == 0 and str(cache) in out and "DSLAB_CACHE_DIR" in out
    assert "0.02 GB of at most 20 GB" in out
    assert "0.1 days ago; the oldest 9.0 days ago" in out


def test_doctor_names_the_folder_and_the_cap(dslab, cache, monkeypatch):
    def none() -> dict:
        raise InputError("GL", "not of interest here", "install none")

    monkeypatch.setattr("dslab.sim.rendering.gl_context.gl_info", none)
    out = dslab("doctor")[1]
    (line,) = [line for line in out.splitlines() if "render cache" in line]
    assert str(cache) in line and "0.02 GB of at most 20 GB" in line


def test_cleaning_by_age_and_all(dslab, cache):
    code, out, _ = dslab("cache", "clean", "--older-than", 7)
    assert (code, out) == (0, f"{cache}: 1 deleted, 0.01 GB\n")
    assert [path.name for path in cache.iterdir()] == ["new"]
    assert dslab("cache", "clean")[1] == f"{cache}: 1 deleted, 0.01 GB\n"
    assert list(cache.iterdir()) == []


def test_an_absent_folder_is_an_empty_cache(dslab, cache, monkeypatch, tmp_path):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "none"))
    code, out, _ = dslab("cache")
    assert code == 0 and "0.00 GB" in out
    assert dslab("cache", "clean")[0] == 0
    assert not (tmp_path / "none").exists()
