"""The cache: atomic, checked on every use, safe for several writers, bounded."""

import gc
import logging
import multiprocessing
import os
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from killed import killed_in_a_folder

from dslab.scenarios.errors import InputError
from dslab.sim import cache
from dslab.sim.cache import FolderCache, content_key, default_cache_dir
from dslab.sim.io.raw import RawFrames, RawWriter
from dslab.sim.unfinished import is_held


def store(root: Path, key: str, text: str = "frames", max_bytes: int = 10**9) -> Path:
    folders = FolderCache(root, max_bytes)
    with folders.create(key) as folder:
        (folder / "data.bin").write_text(text)
    return root / key


def test_an_entry_is_found_with_its_content(tmp_path):
    assert FolderCache(tmp_path).find("k") is None
    store(tmp_path, "k")
    found = FolderCache(tmp_path).find("k")
    assert found is not None
    assert (found / "data.bin").read_text() == "frames"


def test_a_failed_entry_leaves_nothing(tmp_path):
    def fail_half_way() -> None:
        with FolderCache(tmp_path).create("k") as folder:
            (folder / "data.bin").write_text("half")
            raise RuntimeError("boom")

    with pytest.raises(RuntimeError, match="boom"):
        fail_half_way()
    assert list(tmp_path.iterdir()) == []


def flip_a_byte(entry: Path) -> None:
    (entry / "data.bin").write_text("fRames")


def cut_short(entry: Path) -> None:
    (entry / "data.bin").write_text("fra")


def lose_a_file(entry: Path) -> None:
    (entry / "data.bin").unlink()


def spoil_the_manifest(entry: Path) -> None:
    (entry / "manifest.json").write_text("{")


def lose_the_manifest(entry: Path) -> None:
    (entry / "manifest.json").unlink()


@pytest.mark.parametrize(
    "damage", [flip_a_byte, cut_short, lose_a_file, spoil_the_manifest, lose_the_manifest]
)
def test_a_damaged_entry_is_reported_in_a_line_and_not_used(tmp_path, damage, caplog):
    damage(store(tmp_path, "k"))
    with caplog.at_level(logging.WARNING):
        assert FolderCache(tmp_path).find("k") is None
    assert len(caplog.records) == 1
    assert "corrupt" in caplog.records[0].getMessage()
    store(tmp_path, "k", "anew")
    found = FolderCache(tmp_path).find("k")
    assert found is not None and (found / "data.bin").read_text() == "anew"


def _store_slowly(root: str, barrier) -> None:
    with FolderCache(Path(root)).create("k") as folder:
        (folder / "data.bin").write_text("frames")
        barrier.wait()


def test_two_processes_that_make_the_same_entry_leave_one_sound_one(tmp_path):
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(2)
    workers = [context.Process(target=_store_slowly, args=(str(tmp_path), barrier)) for _ in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(30)
    assert [worker.exitcode for worker in workers] == [0, 0]
    assert [path.name for path in tmp_path.iterdir()] == ["k"]
    assert FolderCache(tmp_path).find("k") is not None


def test_the_entries_used_longest_ago_go_first(tmp_path):
    for age, key in enumerate(("new", "old", "oldest")):
        os.utime(store(tmp_path, key, "x" * 1000) / "manifest.json", (time.time() - 100 * age - 50,) * 2)
    assert FolderCache(tmp_path).find("old") is not None  # used just now
    store(tmp_path, "newest", "x" * 1000, max_bytes=4000)
    left = {path.name for path in tmp_path.iterdir()}
    assert "newest" in left and "old" in left and "oldest" not in left


def test_what_a_killed_process_left_is_cleared_by_the_next_and_what_is_at_work_stays(tmp_path):
    with FolderCache(tmp_path).create("slow") as busy:
        (busy / "data.bin").write_text("half")
        killed_in_a_folder(tmp_path, cache.UNFINISHED)
        assert len(list(tmp_path.iterdir())) == 2
        store(tmp_path, "k")
        assert sorted(path.name for path in tmp_path.iterdir()) == [busy.parent.name, "k"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["k", "slow"]


def test_an_unusable_cache_folder_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="DSLAB_CACHE_DIR"), FolderCache(tmp_path / "file").create("k"):
        pass


def test_a_full_disk_while_writing_is_an_input_error_and_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="No space left"), FolderCache(tmp_path).create("k"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_the_default_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "mine"))
    assert default_cache_dir() == tmp_path / "mine"
    monkeypatch.delenv("DSLAB_CACHE_DIR")
    monkeypatch.setattr(cache.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_cache_dir() == tmp_path / "dual-slam-lab"


def test_keys_depend_on_content_and_not_on_order():
    assert content_key({"a": 1, "b": [2, 3]}) == content_key({"b": [2, 3], "a": 1})
    assert content_key({"a": 1}) != content_key({"a": 2})


def test_an_entry_that_vanishes_while_the_cache_is_measured_does_no_harm(tmp_path):
    assert cache._bytes(tmp_path / "gone") == 0


def test_cleaning_deletes_what_was_not_used_for_long_and_leaves_what_is_in_use(tmp_path):
    for name, age_s in (("old", 5000), ("new", 10), ("read", 9000)):
        with (
            FolderCache(tmp_path).create(name) as folder,
            RawWriter(folder / "a.npy", (1, 2, 2), np.uint8) as f,
        ):
            f.append(np.zeros((2, 2), np.uint8))
        os.utime(tmp_path / name / "manifest.json", (time.time() - age_s,) * 2)
    (tmp_path / "notes").mkdir()
    killed_in_a_folder(tmp_path, cache.UNFINISHED)
    frames = RawFrames(tmp_path / "read" / "a.npy", (1, 2, 2), np.uint8)
    with FolderCache(tmp_path).create("busy"):
        deleted, used = FolderCache(tmp_path).clean(1000)
        assert [entry.path.name for entry in deleted] == ["old"]
        assert [entry.path.name for entry in used] == ["read"]
        assert {p.name for p in tmp_path.iterdir() if p.name[0] != "."} == {"new", "notes", "read"}
        assert len(list(tmp_path.glob(".*"))) == 1
    del frames
    deleted, used = FolderCache(tmp_path).clean()
    assert {entry.path.name for entry in deleted} == {"busy", "new", "read"} and not used
    assert [path.name for path in tmp_path.iterdir()] == ["notes"]


def test_frames_in_a_cycle_of_references_close_their_file(tmp_path):
    """And say nothing: an unclosed file is a warning, wherever the collector happens to run."""
    path = tmp_path / "a.npy"
    with RawWriter(path, (1, 2, 2), np.uint8) as writer:
        writer.append(np.zeros((2, 2), np.uint8))
    frames = RawFrames(path, (1, 2, 2), np.uint8)
    frames.itself = frames
    assert is_held(path)
    del frames
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        gc.collect()
    assert not said and not is_held(path)


def test_the_cap_counts_and_deletes_entries_only(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("x" * 5000)
    store(tmp_path, "k", "x" * 1000, max_bytes=2000)
    assert (tmp_path / "thesis" / "chapter.tex").exists() and (tmp_path / "k").exists()
    assert [entry.path.name for entry in FolderCache(tmp_path).entries()] == ["k"]
