"""Folders are written whole or not at all, however the work ends."""

import errno
import os

import pytest
from killed import killed_in_a_folder

from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import check_free, new_directory, scratch_beside, write_file


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


def put_a_file(place):
    place.mkdir(exist_ok=True)
    (place / "precious").write_text("mine")


def put_a_file_in_its_place(place):
    if place.exists():
        place.rmdir()
    place.write_text("mine")


def refused_at_the_end(place, work, replaces=None) -> str:
    """The remedy of the error that ends work which finds its place taken."""

    def whole():
        with new_directory(place, replaces) as folder:
            work(folder)

    with pytest.raises(InputError, match="taken or changed") as caught:
        whole()
    return caught.value.remedy


@pytest.mark.parametrize("is_there", [False, True], ids=["absent", "empty"])
@pytest.mark.parametrize("comes", [put_a_file, put_a_file_in_its_place])
def test_what_came_meanwhile_stays_and_the_result_is_kept_beside_it(tmp_path, is_there, comes):
    place = tmp_path / "a"
    if is_there:
        place.mkdir()

    def work(folder):
        (folder / "x").write_text("1")
        comes(place)

    remedy = refused_at_the_end(place, work)
    assert (place if place.is_file() else place / "precious").read_text() == "mine"
    assert remedy.endswith(f" {tmp_path / 'a-2'}")
    assert (tmp_path / "a-2" / "x").read_text() == "1"
    assert left_behind(tmp_path) == ["a", "a-2"]


def test_of_two_works_into_one_folder_both_are_kept(tmp_path):
    (tmp_path / "a-2").write_text("another")

    def work(slow):
        (slow / "x").write_text("slow")
        with new_directory(tmp_path / "a") as fast:
            (fast / "x").write_text("fast")

    assert refused_at_the_end(tmp_path / "a", work).endswith("a-3")
    assert [(tmp_path / name / "x").read_text() for name in ("a", "a-3")] == ["fast", "slow"]
    assert left_behind(tmp_path) == ["a", "a-2", "a-3"]


@pytest.mark.parametrize("name", ["notes", "marker"])
def test_of_a_result_to_be_replaced_only_what_was_there_at_the_start_goes(tmp_path, name):
    old = tmp_path / "old"
    put_a_file(old)
    (old / "marker").write_text("1")

    def work(folder):
        (folder / "marker").write_text("new")
        (old / name).write_text("changed")

    assert refused_at_the_end(old, work, "marker").endswith("old-2")
    assert (old / name).read_text() == "changed" and (old / "precious").read_text() == "mine"
    assert (tmp_path / "old-2" / "marker").read_text() == "new"
    assert left_behind(tmp_path) == ["old", "old-2"]


def test_a_result_to_be_replaced_may_be_removed_meanwhile(tmp_path):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "marker").write_text("1")
    with new_directory(tmp_path / "old", replaces="marker") as folder:
        (folder / "marker").write_text("new")
        (tmp_path / "old").rename(tmp_path / "elsewhere")
    assert left_behind(tmp_path) == ["elsewhere", "old"]


def test_what_a_killed_process_left_goes_when_the_place_is_written_again(tmp_path):
    killed_in_a_folder(tmp_path, ".a.partial-")
    with new_directory(tmp_path / "a"):
        assert len(left_behind(tmp_path)) == 1
    killed_in_a_folder(tmp_path, ".x.json.partial-")
    write_file(tmp_path / "x.json", lambda path: path.write_text("1"))
    assert left_behind(tmp_path) == ["a", "x.json"]


def test_the_longest_names_can_be_written(tmp_path):
    name = "a" * 255
    assert refused_at_the_end(tmp_path / name, lambda _: put_a_file(tmp_path / name)).endswith("a-2")
    write_file(tmp_path / name[1:], lambda path: path.write_text("1"))
    assert left_behind(tmp_path) == sorted([name, name[1:], f"{name[:48]}-2"])


def test_a_mount_point_is_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os.path, "ismount", lambda path: path == tmp_path)
    with pytest.raises(InputError, match="mount point"):
        check_free(tmp_path)


def test_a_scratch_folder_beside_a_result_goes_with_its_parents(tmp_path):
    with scratch_beside(tmp_path / "a" / "b") as folder:
        assert folder.parents[2] == tmp_path
    with pytest.raises(InputError, match="disk is full"), scratch_beside(tmp_path / "a" / "b"):
        raise OSError(errno.ENOSPC, "no space")
    assert left_behind(tmp_path) == []
