"""Fixtures of tests of several packages."""

import sys
from collections.abc import Callable

import pytest


@pytest.hookimpl(tryfirst=True)  # before xdist reads the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests of a file in one process, and all tests of the shared worker pool in one."""
    for item in items:
        pool = "shared_pool" in getattr(item, "fixturenames", ())
        item.add_marker(pytest.mark.xdist_group("shared pool" if pool else item.path.stem))


@pytest.fixture
def dslab(monkeypatch, capsys) -> Callable[..., tuple[int, str, str]]:
    """Runs the command with its arguments in this process; (exit code, stdout, stderr)."""
    from experiments import cli

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["dslab", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        captured = capsys.readouterr()
        return int(caught.value.code or 0), captured.out, captured.err

    return run
