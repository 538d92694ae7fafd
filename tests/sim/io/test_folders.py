"""Folders are written whole or not at all, however the work ends."""

import errno

import pytest

from scenarios.errors import InputError
from sim.io.folders import check_free, new_directory


def left_behind(root) -> list[str]:
    return sorted(p.name for p in root.iterdir())


def test_a_finished_folder_appears_with_its_files(tmp_path):
    with new_directory(tmp_path / "a" / "b") as folder:
        (folder / "x").write_text("1")
        assert not (tmp_path / "a" / "b").exists()
    assert (tmp_path / "a" / "b" / "x").read_text() == "1"
    assert left_behind(tmp_path / "a") == ["b"]


def test_an_empty_folder_may_be_used(tmp_path):
    (tmp_path / "b").mkdir()
    with new_directory(tmp_path / "b") as folder:
        (folder / "x").write_text("1")
    assert left_behind(tmp_path) == ["b"]
    assert left_behind(tmp_path / "b") == ["x"]


@pytest.mark.parametrize("error", [RuntimeError("broken"), KeyboardInterrupt()])
def test_nothing_is_left_of_unfinished_work(tmp_path, error):
    def work():
        with new_directory(tmp_path / "a" / "b") as folder:
            (folder / "x").write_text("1")
            raise error

    with pytest.raises(type(error)):
        work()
    assert left_behind(tmp_path) == []


@pytest.mark.parametrize(
    ("code", "words"), [(errno.ENOSPC, "disk is full"), (errno.EROFS, "cannot be written")]
)
def test_a_failure_to_write_is_one_clear_line_and_leaves_nothing(tmp_path, code, words):
    with pytest.raises(InputError, match=words) as caught, new_directory(tmp_path / "a") as folder:
        raise OSError(code, "the system's words", str(folder / "x"))
    assert caught.value.where == str(tmp_path / "a")
    assert left_behind(tmp_path) == []


def test_a_failure_to_read_elsewhere_is_not_blamed_on_the_folder(tmp_path):
    with pytest.raises(PermissionError), new_directory(tmp_path / "a"):
        raise PermissionError(errno.EACCES, "denied", "/somewhere/else")


def test_a_taken_place_is_refused_before_any_work(tmp_path):
    (tmp_path / "x").write_text("precious")
    for place in (tmp_path, tmp_path / "x"):
        with pytest.raises(InputError), new_directory(place):
            pytest.fail("the work began")
    with pytest.raises(InputError, match="already holds files"):
        check_free(tmp_path)
    assert left_behind(tmp_path) == ["x"]


def test_a_place_under_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError), new_directory(tmp_path / "file" / "a" / "b"):
        pytest.fail("the work began")
    assert left_behind(tmp_path) == ["file"]


def test_only_an_earlier_result_is_replaced(tmp_path):
    old = tmp_path / "old"
    old.mkdir()
    (old / "notes").write_text("mine")
    with pytest.raises(InputError), new_directory(old, replaces="marker"):
        pytest.fail("the work began")
    (old / "marker").write_text("")
    with new_directory(old, replaces="marker") as folder:
        (folder / "new").write_text("")
    assert left_behind(old) == ["new"]
    assert left_behind(tmp_path) == ["old"]


def test_a_failed_replacement_leaves_the_earlier_result(tmp_path):
    old = tmp_path / "old"
    old.mkdir()
    (old / "marker").write_text("1")
    with pytest.raises(RuntimeError), new_directory(old, replaces="marker"):
        raise RuntimeError
    assert left_behind(old) == ["marker"]
