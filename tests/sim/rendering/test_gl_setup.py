import subprocess
import sys

import pytest

from dslab.sim.rendering import gl_setup
from dslab.sim.rendering.gl_context import EGL_COMMAND, OSMESA_WHEEL

UV = ["--uv", "tools/uv"]


class Machine:
    """A pretended machine, on which GL works at once, after an installation or never."""

    def __init__(self, works_after: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
        self.works_after, self.commands = works_after, []
        monkeypatch.setattr(gl_setup.subprocess, "run", self.run)

    def run(self, command: list[str], **_) -> subprocess.CompletedProcess:
        if command[1] == "-c":
            works = self.works_after is not None and len(self.commands) >= self.works_after
            return subprocess.CompletedProcess(command, 0 if works else 1, "egl, test", "no EGL here")
        self.commands.append(command)
        return subprocess.CompletedProcess(command, 0, "", "")


def test_this_machine_has_working_gl():
    works, text = gl_setup.probe()
    assert works, text


def test_working_gl_installs_nothing(monkeypatch, capsys):
    machine = Machine(0, monkeypatch)
    assert gl_setup.main(UV) == 0
    assert machine.commands == []
    assert capsys.readouterr().out.count("\n") == 1


def test_without_gl_the_wheel_is_installed_into_this_environment_alone(monkeypatch, capsys):
    machine = Machine(1, monkeypatch)
    assert gl_setup.main(UV) == 0
    (command,) = machine.commands
    assert command[0] == "tools/uv" and command[-2:] == ["--no-deps", OSMESA_WHEEL]
    assert command[command.index("--python") + 1] == sys.executable
    assert EGL_COMMAND in capsys.readouterr().out


def test_setup_never_installs_system_packages(monkeypatch, capsys):
    machine = Machine(None, monkeypatch)
    assert gl_setup.main(UV) == 2
    assert [command[0] for command in machine.commands] == ["tools/uv"]
    assert EGL_COMMAND in capsys.readouterr().out.strip().splitlines()[-1]


def test_a_failed_installation_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(gl_setup, "probe", lambda: (False, "no EGL here"))
    assert gl_setup.main(["--uv", "/nonexistent/uv"]) == 2
    assert "uv failed" in capsys.readouterr().out.splitlines()[2]
