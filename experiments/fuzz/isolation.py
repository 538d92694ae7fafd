"""Jobs in processes of their own, which may hang or die without taking anything with them."""

import faulthandler
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Generic, TypeVar

Item = TypeVar("Item")
Row = TypeVar("Row")
Job = Callable[[Item], Iterable[Row]]
"""Called in another process: it and its items must be such as can be pickled."""


@dataclass(frozen=True)
class Death(Generic[Item]):
    """The end of a process that was at work.

    Attributes:
        item: what it was at.
        rows: how many rows of it had come.
        timed_out: it was ended for taking too long.
        report: where every thread of it was, as far as could be told.
    """

    item: Item
    rows: int
    timed_out: bool
    report: str


def run_isolated(
    job: Job[Item, Row],
    items: Iterable[Item],
    workers: int,
    timeout_s: float,
    after_death: Callable[[Death[Item]], tuple[list[Row], Item | None]],
) -> Iterator[Row]:
    """Run a job on every item and give the rows that it yields as they come.

    Args:
        job: a function of a module; its process lives on to the next item.
        items: what to run it on.
        workers: processes.
        timeout_s: the longest that may pass from one row to the next. The end is put to a process from
            within, by a thread that needs nothing of the interpreter: one that is caught in compiled code
            ends as well.
        after_death: asked for the rows that stand in for what a process that died owes, and for what is left
            to do of its item, None for nothing.
    """
    waiting = deque(items)
    pool: list[_Worker] = []
    with tempfile.TemporaryDirectory(prefix="dslab-") as folder:
        try:
            while waiting or any(worker.item is not None for worker in pool):
                while waiting and len(pool) < workers:
                    pool.append(_Worker(job, timeout_s, Path(folder)))
                for worker in pool:
                    if worker.item is None and waiting:
                        worker.take(waiting.popleft())
                busy = [worker for worker in pool if worker.item is not None]
                ready = connection.wait([worker.pipe for worker in busy])
                for worker in [w for w in busy if w.pipe in ready]:
                    try:
                        yield from worker.rows()
                    except EOFError:
                        pool.remove(worker)
                        rows, left = after_death(worker.bury())
                        yield from rows
                        if left is not None:
                            waiting.appendleft(left)
        finally:
            for worker in pool:
                worker.end()


class _Worker(Generic[Item, Row]):
    """One process, seen from the outside."""

    def __init__(self, job: Job[Item, Row], timeout_s: float, folder: Path) -> None:
        # Spawned, not forked: a process that holds a GL context must not fork.
        context = get_context("spawn")
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".txt", delete=False) as file:
            self._report = Path(file.name)
        self.item: Item | None = None
        self._done = 0
        self.pipe, theirs = context.Pipe()
        self._process: BaseProcess = context.Process(
            target=_serve, args=(theirs, job, timeout_s, self._report), daemon=True
        )
        self._process.start()
        theirs.close()

    def take(self, item: Item) -> None:
        """Set to work on an item."""
        self.item, self._done = item, 0
        # A process that has died meanwhile is found out when its rows are asked for.
        with suppress(BrokenPipeError):
            self.pipe.send(item)

    def rows(self) -> Iterator[Row]:
        """The next row, none at the end of the item. Raises EOFError where the process has died."""
        try:
            row = self.pipe.recv()
        except ConnectionResetError as error:
            raise EOFError from error
        if row is None:
            self.item = None
        else:
            self._done += 1
            yield row[0]

    def bury(self) -> Death[Item]:
        """What is known of the end of a process that has died."""
        self.pipe.close()
        self._process.join()
        report = self._report.read_text(errors="replace").strip()
        timed_out = report.startswith("Timeout")
        code = self._process.exitcode
        if self.item is None:
            raise RuntimeError(f"a worker without work has died, exit code {code}")
        return Death(self.item, self._done, timed_out, report or f"the process has died, exit code {code}")

    def end(self) -> None:
        """End the process, whatever it is doing."""
        self.pipe.close()
        self._process.kill()
        self._process.join()


def _serve(pipe: Connection, job: Job, timeout_s: float, report: Path) -> None:
    """The life of a process: items in, rows out, one in a tuple each, None after the last of an item."""
    with report.open("w") as file:
        faulthandler.enable(file)
        while True:
            try:
                item = pipe.recv()
            except EOFError:
                return
            faulthandler.dump_traceback_later(timeout_s, exit=True, file=file)
            for row in job(item):
                pipe.send((row,))
                faulthandler.dump_traceback_later(timeout_s, exit=True, file=file)
            faulthandler.cancel_dump_traceback_later()
            pipe.send(None)
