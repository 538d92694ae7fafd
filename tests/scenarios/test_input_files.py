"""The boundary of files: regular ones of bounded size, JSON of bounded depth, one line for every fault."""

import os
import socket
import time
import tracemalloc
from pathlib import Path

import pytest

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import (
    IMAGE_BYTES,
    file_names,
    is_folder,
    is_given,
    open_file,
    read_bytes,
    read_json,
    read_text,
)


def one_line(read, *arguments) -> str:
    """The line of the InputError, which must come at once."""
    started_s = time.process_time()
    with pytest.raises(InputError) as caught:
        read(*arguments)
    assert "\n" not in str(caught.value) and time.process_time() - started_s < 5
    return str(caught.value)


def make_pipe(place: Path) -> Path:
    os.mkfifo(place / "pipe")
    return place / "pipe"


def make_socket(place: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(place / "s"))
    return place / "s"


def make_locked(place: Path) -> Path:
    (place / "locked").write_text("")
    (place / "locked").chmod(0)
    return place / "locked"


NOT_FILES = {
    "no such file": lambda place: place / "none",
    "is a folder": lambda place: place,
    "is a pipe": make_pipe,
    "is a socket": make_socket,
    "is a device": lambda place: Path("/dev/zero"),
    "File name too long": lambda place: place / ("a" * 300),
    "no possible name": lambda place: place / "a\0b",
    "Not a directory": lambda place: Path(__file__) / "x",
    "Permission denied": make_locked,
}


@pytest.mark.parametrize("problem", NOT_FILES)
def test_only_regular_files_are_opened(tmp_path, problem):
    if problem == "Permission denied" and os.geteuid() == 0:
        pytest.skip("the superuser may read everything")
    path = NOT_FILES[problem](tmp_path)
    assert problem in one_line(read_bytes, path, 100)
    assert problem in one_line(open_file, path)


def test_a_pipe_that_takes_the_place_of_a_file_is_not_waited_for(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    regular = os.stat(tmp_path / "file")
    pipe = make_pipe(tmp_path)
    monkeypatch.setattr("dslab.scenarios.input_files.os.stat", lambda path: regular)
    assert "is a pipe" in one_line(read_bytes, pipe, 100)


def test_a_file_is_read_up_to_its_limit_even_if_its_size_is_not_stated(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"x" * 101)
    assert read_bytes(tmp_path / "file", 101) == b"x" * 101
    assert "more than the 0.0001 MB" in one_line(read_bytes, tmp_path / "file", 100)
    monkeypatch.setattr("dslab.scenarios.input_files._check_regular", lambda path, status, most_bytes: None)
    assert "more than" in one_line(read_bytes, tmp_path / "file", 100)
    assert "more than" in one_line(read_bytes, Path("/dev/zero"), 100)


def test_text_is_utf_8(tmp_path):
    (tmp_path / "file").write_bytes("é".encode("latin-1"))
    assert "is not UTF-8 text" in one_line(read_text, tmp_path / "file", 100)


@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000, "a\0b", "none", "\udcff"])
def test_asking_for_an_impossible_name_raises_nothing(tmp_path, name):
    assert not is_given(tmp_path / name) and not is_folder(tmp_path / name)
    one_line(file_names, tmp_path / name)


def test_a_broken_link_is_given_and_not_taken_for_nothing(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "none")
    assert is_given(tmp_path / "link")
    assert "no such file" in one_line(read_bytes, tmp_path / "link", 100)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "no valid JSON"),
        ("{", "no valid JSON"),
        ("[]", "holds no object"),
        ("3", "holds no object"),
        ('{"a": 1, "a": 2}', "key 'a' appears twice"),
        ('{"b": [{"a": 1, "a": 2}]}', "key 'a' appears twice"),
        ('{"a": NaN}', "not a finite number"),
        ('{"a": -Infinity}', "not a finite number"),
        ('{"a": 1e999}', "not a finite number"),
        ('{"a": ' + "9" * 401 + "}", "more than 64 bits"),
        ('{"a": ' + "9" * 9999 + "}", "more than 64 bits"),
        ('{"a": ' + "[" * 100_000, "levels deep"),
        ('{"a": ' + '{"a":' * 100_000, "levels deep"),
        ('{"a": [' + "[]," * 1_000_000 + "[]]}", "parts"),
        ('{"a": "' + '\\"' * 1_000_000, "no valid JSON"),
        ('{"a": "' + '\\"' * 1_000_000 + "\\", "no valid JSON"),
    ],
    ids=range(16),
)
def test_json_is_checked_before_it_is_made(tmp_path, text, problem):
    (tmp_path / "file").write_text(text)
    assert problem in one_line(read_json, tmp_path / "file", dict)


def test_sound_json_is_read_as_json_is(tmp_path):
    (tmp_path / "file").write_text(
        '[{"a": "[[[[\\"{{{", "b": [1, -2.5, 1e3, null, true], "c": {}}, 18446744073709551615]'
    )
    expected = [{"a": '[[[["{{{', "b": [1, -2.5, 1000.0, None, True], "c": {}}, 2**64 - 1]
    assert read_json(tmp_path / "file", list) == expected


def test_a_small_file_takes_little_memory_whatever_its_most(tmp_path):
    (tmp_path / "x").write_bytes(b"abc")
    tracemalloc.start()
    try:
        assert read_bytes(tmp_path / "x", IMAGE_BYTES) == b"abc"
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()
