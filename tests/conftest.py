"""Fixtures of tests of several packages."""

import sys
from collections.abc import Callable

import pytest


@pytest.fixture
def dslab(monkeypatch, capsys) -> Callable[..., tuple[int, str, str]]:
    """Runs the command with its arguments in this process; (exit code, stdout, stderr)."""
    from dslab.experiments import cli
    from dslab.experiments.cli import console

    # A console that was made while COLUMNS was set would keep that width for ever.
    for one in (console.out, console.err):
        monkeypatch.setattr(one, "_width", None)

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["dslab", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        captured = capsys.readouterr()
        return int(caught.value.code or 0), captured.out, captured.err

    return run
