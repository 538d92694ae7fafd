import subprocess
from pathlib import Path

import pytest

from sim.rendering import gl_setup

UV = ["--uv", "tools/uv"]


class Machine:
    """A pretended machine: GL works once one of the given commands has run."""

    def __init__(self, works_after: str | None, root: bool, monkeypatch: pytest.MonkeyPatch) -> None:
        self.works_after, self.commands = works_after, []
        monkeypatch.setattr(gl_setup.subprocess, "run", self.run)
        monkeypatch.setattr(gl_setup.os, "geteuid", lambda: 0 if root else 1000)
        monkeypatch.setattr(gl_setup.shutil, "which", lambda name: f"/usr/bin/{name}")

    def run(self, command: list[str], **_) -> subprocess.CompletedProcess:
        if command[1] == "-c":
            works = self.works_after is not None and any(
                self.works_after in done for done in ["", *self.commands]
            )
            return subprocess.CompletedProcess(command, 0 if works else 1, "egl, test", "no EGL here")
        self.commands.append(" ".join(command))
        return subprocess.CompletedProcess(command, 0, "", "")


def test_this_machine_is_found_to_work():
    works, what = gl_setup.probe()
    assert works, what


def test_working_gl_installs_nothing(monkeypatch, capsys):
    machine = Machine("", True, monkeypatch)
    assert gl_setup.main(UV) == 0
    assert machine.commands == []
    assert capsys.readouterr().out.count("\n") == 1


def test_root_gets_the_system_packages(monkeypatch):
    machine = Machine("libgl1-mesa-dri", True, monkeypatch)
    assert gl_setup.main(UV) == 0
    assert [c.split()[0] for c in machine.commands] == ["apt-get", "apt-get"]


def test_without_root_comes_the_wheel(monkeypatch):
    machine = Machine("--extra osmesa", False, monkeypatch)
    assert gl_setup.main(UV) == 0
    (command,) = machine.commands
    assert command.startswith(str(Path("tools/uv"))) and "--frozen" in command and "--extra evo" in command


def test_the_wheel_is_the_way_out_when_the_packages_do_not_help(monkeypatch):
    machine = Machine("--extra osmesa", True, monkeypatch)
    assert gl_setup.main(UV) == 0
    assert len(machine.commands) == 3


def test_when_nothing_helps_the_last_line_says_what_to_install(monkeypatch, capsys):
    Machine(None, True, monkeypatch)
    assert gl_setup.main(UV) == 2
    assert "libegl1" in capsys.readouterr().out.strip().splitlines()[-1]
