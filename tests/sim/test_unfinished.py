"""Folders under way: gone with their work, and swept if it was killed; nothing else is touched."""

import errno
import fcntl
import shutil

import pytest
from killed import killed_in_a_folder

from dslab.sim import unfinished
from dslab.sim.unfinished import remove_own, sweep, unfinished_folder

ALIKE = "p-0123456789ab"


@pytest.mark.parametrize("error", [None, RuntimeError("broken"), KeyboardInterrupt()])
def test_a_folder_is_gone_with_its_block(tmp_path, error):
    def work():
        with unfinished_folder(tmp_path, "p-") as folder:
            (folder / "x").write_text("half")
            if error:
                raise error

    if error:
        with pytest.raises(type(error)):
            work()
    else:
        work()
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_swept_and_what_is_at_work_stays(tmp_path):
    killed_in_a_folder(tmp_path, "p-")
    killed_in_a_folder(tmp_path, "q-")
    with unfinished_folder(tmp_path, "p-") as busy, unfinished_folder(tmp_path, "p-"):
        left = {path.name[:2] for path in tmp_path.iterdir() if path != busy.parent}
        assert left == {"p-", "q-"} and busy.is_dir() and len(list(tmp_path.iterdir())) == 3


def test_a_folder_of_someone_else_with_such_a_name_stays(tmp_path):
    for name in (ALIKE, "p-mine", "p-"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "precious").write_text("")
    (tmp_path / "p-empty").mkdir()
    (tmp_path / "p-aaaaaaaaaaaa").symlink_to(tmp_path / ALIKE)
    sweep(tmp_path, "p-")
    assert len(list(tmp_path.iterdir())) == 5


def test_what_was_killed_before_it_was_locked_is_swept(tmp_path):
    (tmp_path / ALIKE).mkdir()
    sweep(tmp_path, "p-")
    assert list(tmp_path.iterdir()) == []


def test_where_there_are_no_locks_nothing_is_taken_for_dead(tmp_path, monkeypatch):
    killed_in_a_folder(tmp_path, "p-")

    def no_locks(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with unfinished_folder(tmp_path, "p-") as folder:
        assert folder.is_dir() and len(list(tmp_path.iterdir())) == 2
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_is_swept_before_it_is_locked_is_made_anew(tmp_path, monkeypatch):
    make, swept = unfinished.take_lock, []

    def late(file):
        if not swept:
            swept.extend(tmp_path.iterdir())
            shutil.rmtree(swept[0])
        return make(file)

    monkeypatch.setattr(unfinished, "take_lock", late)
    with unfinished_folder(tmp_path, "p-") as folder:
        assert folder.is_dir() and folder.parent != swept[0]


def test_what_an_interruption_left_at_a_wrong_moment_is_removed_at_the_end(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt), unfinished_folder(tmp_path, "p-"):
        patch.setattr(shutil, "rmtree", interrupted)
    assert len(list(tmp_path.iterdir())) == 1
    remove_own()
    assert list(tmp_path.iterdir()) == []
