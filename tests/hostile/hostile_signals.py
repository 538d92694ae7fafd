"""Real commands that are sent a signal at some moment, and what they leave."""

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
from hostile_examples import EVERYTHING
from hostile_oracle import filled

COMMANDS = {
    "render": "export {in}/scenario/scenario.yaml --depth --out {out}",
    "render without cache": "export {in}/scenario/scenario.yaml --no-cache --out {out}",
    "degrade": "degrade {in}/tum --segment jpeg:start_s=0.1,duration_s=0.2,quality=8 --out {out}",
    "run": "run {in}/scenario/scenario.yaml --system dual --rerun --map --out {out}",
    "demo": "demo --no-units --out {out}",
    "gallery": "scenarios gallery {in}/scenario/scenario.yaml --seeds 2 --frames 2 --workers 2 --out {out}",
    "program": "run {in}/tum --system copy --systems {in}/systems --out {out}",
    "batch": "batch {in}/batch.yaml --out {out}",
    "experiment": "experiment run {in}/experiment/spec.yaml --workers 2 --out {out}",
    "fuzz": "experiment fuzz --units 1 --system base --out {out}",
}
LONG = {"fuzz", "demo"}
"""Commands whose second start is ended by a signal too, as they take a while."""
RESUMED = {"batch", "experiment"}
"""Commands that go on where they were, whatever has ended them."""
_MOST_S = 40.0
_BAD = ("Traceback", "Fatal Python error", "Segmentation", "Aborted", "core dumped", "most recent call first")
_START = """
import os
from contextlib import contextmanager
from dslab.experiments import cli
heeding = cli.signals_as_interrupts

@contextmanager
def told():
    with heeding() as received:
        os.write({pipe}, b"x")
        yield received

cli.signals_as_interrupts = told
cli.main()
"""


@dataclass
class Running:
    """A command in a session of its own, with its handlers set."""

    process: subprocess.Popen
    mark: str
    err: Path

    def end(self, number: int) -> tuple[int, str]:
        """Send the signal, 0 for none; exit code and errors."""
        if number:
            self.process.send_signal(number)
        code = self.process.wait(_MOST_S)
        return code, self.err.read_text(errors="replace")


class Place:
    """A folder with inputs, outputs, cache and temporary files for one command."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.result = folder, folder / "out" / "result"
        EVERYTHING.write(folder / "given")
        for name in ("out", "tmp", "cache"):
            (folder / name).mkdir()
        self._starts = 0

    def start(self, name: str) -> Running:
        """Start a command and wait until it has set its handlers."""
        places = {"{in}": str(self.folder / "given"), "{out}": str(self.result)}
        words = [filled(word, places) for word in COMMANDS[name].split()]
        self._starts += 1
        mark, err = f"{self.folder}-{self._starts}", self.folder / f"stderr-{self._starts}"
        environment = {
            **os.environ, "TMPDIR": str(self.folder / "tmp"), "DSLAB_CACHE_DIR": str(self.folder / "cache"),
            "OMP_NUM_THREADS": "1", "HOSTILE_MARK": mark,
            "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
        }  # fmt: skip
        ready, pipe = os.pipe()
        with err.open("w") as stderr, (self.folder / "stdout").open("w") as stdout:
            process = subprocess.Popen(
                [sys.executable, "-c", _START.format(pipe=pipe), *words], env=environment, cwd=self.folder,
                stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr, start_new_session=True,
                pass_fds=[pipe], preexec_fn=_heed_signals,  # noqa: PLW1509  no threads here
            )  # fmt: skip
        os.close(pipe)
        os.read(ready, 1)
        os.close(ready)
        return Running(process, mark, err)

    def done(self, name: str) -> bool:
        """The result is there; that of a batch or an experiment is there from the start."""
        return self.result.exists() and name not in ("batch", "experiment")

    def lacking(self) -> list[str]:
        """What the table of a batch lacks that has gone on to its end."""
        with (self.result / "runs.csv").open() as file:
            ended = [(row["run"], row["ended"]) for row in csv.DictReader(file)]
        return [] if ended == [("0", "finished"), ("1", "finished")] else [f"runs.csv has {ended}"]

    def debris(self) -> list[str]:
        """What no command may leave: anything but a whole result."""
        left = list((self.folder / "tmp").iterdir())
        left += [path for path in (self.folder / "out").iterdir() if path.name != "result"]
        left += [path for path in (self.folder / "cache").iterdir() if path.name.startswith(".")]
        left += [path for path in (self.folder / "out").rglob(".*") if path not in left]
        return [f"left {path.relative_to(self.folder)}" for path in left]


def _heed_signals() -> None:
    """Undo what nohup, or a shell in the background, has told its children to ignore."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def survivors(mark: str, seconds: float) -> list[str]:
    """Names of the processes of a command that still live after this time; they are ended."""
    until = time.monotonic() + seconds
    while (alive := _marked(mark)) and time.monotonic() < until:
        time.sleep(0.1)
    names = [process.info["name"] for process in alive]
    for process in alive:
        process.kill()
    return names


def faults_of(code: int, err: str, number: int, done: bool) -> list[str]:
    """What is wrong with the end of a command after a signal; its result was done or not."""
    if number == signal.SIGTERM and code == -number and "*** SIGTERM (@" in err:
        return []  # in the 30 ms of the import of pycolmap, whose handler ends the process: see slam.colmap
    faults = [f"{word} on stderr: {err[-600:]!r}" for word in _BAD if word in err][:1]
    # Once all is done, Python ends by itself, and a signal ends it without a word.
    expected = {0, -number if done or number == signal.SIGKILL else 128 + number}
    if code not in expected | {128 + number}:
        faults.append(f"exit code {code} after signal {number}: {err[-600:]!r}")
    return faults


def _marked(mark: str) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter(["name", "status"]):
        try:
            if (
                process.info["status"] != psutil.STATUS_ZOMBIE
                and process.environ().get("HOSTILE_MARK") == mark
            ):
                found.append(process)
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
    return found
