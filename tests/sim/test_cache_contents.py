"""Entries of the cache with another content than was written: found, dropped, rendered again."""

import json
import logging
import os
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from test_render_sequence import SPEC, digest, fake_backend

from dslab.scenarios.spec import Scenario
from dslab.sim.cache import CorruptEntryError, FolderCache, _write_manifest
from dslab.sim.io.raw import RawFrames, RawWriter, stored_array, stored_columns
from dslab.sim.sequence_rendering import render_sequence

JPEG = {"kind": "jpeg", "start_s": 0.1, "duration_s": 0.2, "quality": 5}
SHORT = Scenario.model_validate({**SPEC, "duration_s": 0.5, "segments": [JPEG]})


@pytest.fixture(scope="module")
def filled(tmp_path_factory) -> Path:
    """A cache with the entries of a short scenario: frames with depth, frames alone, exposed frames."""
    root = tmp_path_factory.mktemp("cache")
    render(root, depth=False)
    render(root, depth=True)
    return root


def render(root: Path, depth: bool):
    return render_sequence(SHORT, cache_dir=root, depth=depth, backend=fake_backend())


def only_entry_with(root: Path, file: str) -> Path:
    (found,) = [entry for entry in root.iterdir() if (entry / file).exists()]
    for other in set(root.iterdir()) - {found}:
        shutil.rmtree(other)
    return found


def save(path: Path, array: np.ndarray) -> None:
    np.savez(path, blur_px=array) if path.suffix == ".npz" else np.save(path, array)


@pytest.mark.parametrize(
    ("file", "content", "exposed"),
    [
        ("gray.npy", np.zeros((5, 64, 95), np.uint8), False),
        ("gray.npy", np.zeros((4, 64, 96), np.uint8), False),
        ("gray.npy", np.zeros((5, 64, 96), np.float32), False),
        ("gray.npy", b"", False),
        ("gray.npy", b"PK\x03\x04", False),
        ("depth.npy", np.zeros((5, 64, 96), np.uint8), False),
        ("stamps_s.npy", np.zeros(5), False),
        ("stamps_s.npy", np.arange(6.0), False),
        ("stamps_s.npy", np.array(["a"], object), False),
        ("stamps_s.npy", np.float64(3), False),
        ("T_world_cam.npy", np.zeros((5, 3, 4)), False),
        ("frame_truth.npz", np.zeros(4), False),
        ("frame_truth.npz", np.array([None] * 5, object), False),
        ("frame_truth.npz", b"", False),
        ("frame_truth.npz", np.lib.format.magic(1, 0), False),
        ("segments.json", b"{}", False),
        ("segments.json", b'[{"kind": 1}]', False),
        ("segments.json", b"[" * 5000, False),
        ("view_share.npy", np.zeros((4, 10), np.float32), True),
        ("view_share.npy", np.zeros((5, 10)), True),
        ("gray.npy", np.zeros((5, 63, 96), np.uint8), True),
        ("frame_truth.npz", np.zeros(6), True),
    ],
    ids=range(22),
)
def test_an_entry_of_another_shape_is_rendered_again(filled, tmp_path, caplog, file, content, exposed):
    expected = digest(render(filled, depth=True))
    root = tmp_path / "cache"
    shutil.copytree(filled, root)
    entry = only_entry_with(root, "view_share.npy" if exposed else "depth.npy")
    if isinstance(content, bytes):
        (entry / file).write_bytes(content)
    else:
        (entry / file).unlink()
        save(entry / file, content)
    (entry / "manifest.json").unlink()
    _write_manifest(entry)
    with caplog.at_level(logging.WARNING):
        assert digest(render(root, depth=not exposed)) == expected
    assert len(caplog.records) == 1 and f"is corrupt ({file}" in caplog.records[0].getMessage()


@pytest.mark.parametrize(
    "change",
    [
        lambda files: [],
        lambda files: None,
        lambda files: {},
        lambda files: {name: [] for name in files},
        dict.fromkeys,
        lambda files: {name: {**file, "bytes": [file["bytes"]]} for name, file in files.items()},
        lambda files: {name: {**file, "sha256": None} for name, file in files.items()},
        lambda files: {**files, "../other": {"bytes": 1, "sha256": ""}},
        lambda files: {**files, "a" * 300: {"bytes": 1, "sha256": ""}},
        lambda files: {**files, "a\0": {"bytes": 1, "sha256": ""}},
        lambda files: dict(list(files.items())[1:]),
    ],
    ids=range(11),
)
def test_a_manifest_of_another_shape_or_of_other_files_is_a_corrupt_entry(tmp_path, caplog, change):
    store = FolderCache(tmp_path)
    with store.create("k") as folder:
        (folder / "a.bin").write_text("a")
        (folder / "b.bin").write_text("b")
    files = json.loads((tmp_path / "k/manifest.json").read_text())["files"]
    (tmp_path / "k/manifest.json").write_text(json.dumps({"files": change(files)}))
    with caplog.at_level(logging.WARNING):
        assert store.find("k") is None
    assert len(caplog.records) == 1 and not (tmp_path / "k").exists()


@pytest.mark.parametrize("name", ["a.bin", "manifest.json"])
def test_a_pipe_in_an_entry_is_not_waited_for(tmp_path, name):
    store = FolderCache(tmp_path)
    with store.create("k") as folder:
        (folder / "a.bin").write_text("")
    (tmp_path / "k" / name).unlink()
    os.mkfifo(tmp_path / "k" / name)
    assert store.find("k") is None


def test_damaged_arrays_are_corrupt_whatever_their_bytes(tmp_path):
    with RawWriter(tmp_path / "a.npy", (2, 3, 4), np.uint8) as writer:
        writer.append(np.zeros((3, 4), np.uint8))
        writer.append(np.ones((3, 4), np.uint8))
    assert RawFrames(tmp_path / "a.npy", (2, 3, 4), np.uint8)[1].all()
    np.savez(tmp_path / "a.npz", x=np.arange(3.0))
    rng = np.random.default_rng(0)
    for name, read in (
        ("a.npy", lambda path: stored_array(path, (2, 3, 4), np.uint8)),
        ("a.npz", lambda path: stored_columns(path, 3)),
    ):
        data = (tmp_path / name).read_bytes()
        for _ in range(150):
            damaged = bytearray(data)
            for at in rng.integers(0, 130, 2):
                damaged[at] = rng.integers(256)
            (tmp_path / name).write_bytes(damaged)
            with suppress(CorruptEntryError):
                read(tmp_path / name)
