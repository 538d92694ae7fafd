"""How a command ends: by signals, and when what it prints cannot be encoded or written."""

import ctypes
import errno
import io
import os
import shlex
import signal
import subprocess
import sys
import time

import pytest
from rich.table import Table
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.cli import console
from dslab.experiments.cli.signals import signals_as_interrupts
from dslab.experiments.cli.streams import safe_streams
from dslab.experiments.runs import slam_settings, sources
from dslab.sim.io.tum import write_tum

HOSTILE = "a[/b] :smile: [red]\udcff{x}"


@pytest.fixture
def source(monkeypatch, no_picture):
    """`dslab run` of any source runs the fake system over a synthetic sequence."""
    sequence = make_sequence()
    monkeypatch.setattr(sources, "open_sequence", lambda source, seed, show, **options: sequence)
    monkeypatch.setattr(slam_settings, "factory_of", lambda settings: fake_factory(sequence))


def wait_for_the_signal():
    for _ in range(200):
        time.sleep(0.01)
    pytest.fail("no interruption")


@pytest.mark.parametrize(
    ("sent", "words"),
    [("SIGINT", "interrupted"), ("SIGTERM", "ended by SIGTERM"), ("SIGHUP", "ended by SIGHUP")],
)
def test_a_signal_is_one_line_and_128_plus_its_number_and_leaves_nothing(
    dslab, monkeypatch, source, tmp_path, sent, words
):
    def signalled(*_, **__):
        os.kill(os.getpid(), number)
        wait_for_the_signal()

    monkeypatch.setattr("dslab.experiments.result_folder.run_system", signalled)
    number = getattr(signal, sent)
    if signal.getsignal(number) is signal.SIG_IGN:  # these tests may run in the background, or under nohup
        signal.signal(number, signal.default_int_handler)
    before = signal.getsignal(signal.SIGTERM)
    code, out, err = dslab("run", "x", "--out", tmp_path / "a" / "o")
    assert (code, out) == (128 + number, "")
    assert err.splitlines() == [f"{words}: nothing half-written is left"]
    assert list(tmp_path.iterdir()) == [] and signal.getsignal(signal.SIGTERM) is before


def test_what_fails_after_a_signal_is_still_an_interruption(dslab, monkeypatch, source, tmp_path):
    def signalled(*_, **__):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            wait_for_the_signal()
        finally:
            raise RuntimeError("a process of the group has ended too")

    monkeypatch.setattr(sources, "open_sequence", signalled)
    code, _, err = dslab("run", "x", "--out", tmp_path / "o")
    assert code == 143 and err.count("\n") == 1


def test_a_signal_that_is_ignored_stays_ignored(monkeypatch):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with signals_as_interrupts() as received:
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(0.01)
        assert received == [] and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_further_signals_do_not_cut_the_clearing_up():
    cleared = []

    def work():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            wait_for_the_signal()
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.01)
            cleared.append(True)

    with signals_as_interrupts() as received, pytest.raises(KeyboardInterrupt):
        work()
    assert cleared and received == [signal.SIGTERM] * 2


def test_an_interruption_that_a_callback_swallows_comes_again():
    @ctypes.CFUNCTYPE(None)
    def callback():
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(10):
            pass

    def work():
        callback()
        wait_for_the_signal()

    with signals_as_interrupts(), pytest.raises(KeyboardInterrupt):
        work()


def test_the_solver_leaves_sigterm_alone():
    program = "import dslab.slam.colmap, os, signal; os.kill(os.getpid(), signal.SIGTERM)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False, timeout=60)
    assert (ended.returncode, ended.stderr) == (-signal.SIGTERM, b"")


class Full(io.StringIO):
    """A stream on a device that is full, or a pipe that is closed."""

    def __init__(self, fault: int) -> None:
        super().__init__()
        self.fault = fault

    def write(self, text: str) -> int:
        raise OSError(self.fault, os.strerror(self.fault))


@pytest.mark.parametrize(("fault", "code", "lines"), [(errno.ENOSPC, 1, 1), (errno.EPIPE, 141, 0)])
@pytest.mark.parametrize("command", [["paper"], ["paper", "--json"], ["--version"], ["scenarios", "schema"]])
def test_output_that_cannot_be_written_is_an_ending(dslab, monkeypatch, fault, code, lines, command):
    monkeypatch.setattr(sys, "stdout", Full(fault))
    ended, _, err = dslab(*command)
    assert ended == code and len(err.splitlines()) == lines
    if lines:
        assert err.startswith("error: standard output: cannot be written (No space left")


def test_errors_that_cannot_be_written_do_not_end_the_work(dslab, monkeypatch, source, tmp_path):
    monkeypatch.setattr(sys, "stderr", Full(errno.ENOSPC))
    assert dslab("run", "x", "--out", tmp_path / "o")[0] == 0
    assert dslab("run", "x", "--out", tmp_path / "o")[0] == 2


def test_a_stream_that_anothers_code_closes_stays_open(capsys):
    with safe_streams():
        for stream in (sys.stdout, sys.stderr):
            stream.close()
            print("more", file=stream)
    assert capsys.readouterr() == ("more\n", "more\n")


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_whatever_is_in_a_name_is_printed(dslab, monkeypatch, source, tmp_path, encoding):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding, write_through=True))
    code, *_ = dslab("run", "x", "--out", tmp_path / HOSTILE)
    assert code == 0 and (tmp_path / HOSTILE).is_dir()
    said = raw.getvalue().decode(encoding).replace("\n", "")
    assert HOSTILE.replace("\udcff", "\\udcff") in said


def test_whatever_is_in_a_name_is_shown_in_progress(monkeypatch):
    shown = io.StringIO()
    terminal = console.Console(file=shown, force_terminal=True, width=200)
    monkeypatch.setattr("dslab.experiments.cli.console.err", terminal)
    with console.progress_bars() as show:
        show(HOSTILE, 1, 2, HOSTILE)
    assert shown.getvalue().count(HOSTILE) >= 2


def test_a_table_parses_no_markup(capsys):
    table = Table("x", title=HOSTILE)
    table.add_row(HOSTILE)
    with safe_streams():
        console.out.print(table)
    assert capsys.readouterr().out.count("[/b]") == 2


_DSLAB = "from dslab.experiments.cli import main; main()"


def _limited(limit: str, value: str, words: list, tmp_path) -> subprocess.CompletedProcess:
    """A command in a shell with a limit, or one that has lost its folder."""
    program = f"{limit} {value}; exec {shlex.join([sys.executable, '-c', _DSLAB, *map(str, words)])}"
    gone = tmp_path / "gone"
    gone.mkdir()
    environment = {**os.environ, "DSLAB_CACHE_DIR": str(tmp_path / "cache")}
    return subprocess.run(
        ["sh", "-c", program],
        cwd=gone,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "value", "says"),
    [
        ("ulimit -f", "8", "a file would be larger than the limit of this shell; raise `ulimit -f`"),
        ("ulimit -v", "600000", "this machine: has no memory left; raise `ulimit -v`"),
        ("rmdir", "../gone", "the present folder: cannot be used (No such file or directory); change to one"),
    ],
)
def test_what_the_machine_refuses_is_one_line(tmp_path, limit, value, says):
    write_tum(make_sequence(10, segment=None), tmp_path / "drive")
    ended = _limited(limit, value, ["run", tmp_path / "drive", "--out", tmp_path / "o"], tmp_path)
    assert ended.returncode in (1, 2) and ended.stderr.count("\n") == 1 and says in ended.stderr
    assert not (tmp_path / "o").exists()


def test_memory_that_is_not_there_is_one_line(dslab, monkeypatch, source, tmp_path):
    monkeypatch.setattr(sources, "open_sequence", lambda *_, **__: bytearray(2**60))
    code, _, err = dslab("run", "x", "--out", tmp_path / "o")
    assert (code, err.splitlines()) == (
        1, ["error: this machine: has no memory left; raise `ulimit -v`, or take fewer or smaller frames"],
    )  # fmt: skip


@pytest.mark.parametrize(("mask", "mode"), [(0o000, 0o755), (0o002, 0o775), (0o077, 0o700)])
def test_without_a_mask_nobody_else_may_write_what_is_made(dslab, source, tmp_path, mask, mode):
    before = os.umask(mask)
    try:
        assert dslab("run", "x", "--out", tmp_path / "o")[0] == 0
    finally:
        os.umask(before)
    assert (tmp_path / "o").stat().st_mode & 0o777 == mode
    assert {path.stat().st_mode & 0o777 for path in (tmp_path / "o").iterdir()} == {mode & 0o666}
