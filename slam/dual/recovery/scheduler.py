"""Scheduler of the recovery threads of one breakage, which run one after another beside tracking.

In lockstep mode they run at once, and each counts as ended when its cost model says that it would have ended:
results do not depend on the load of the machine. In threaded mode they run in a worker thread.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from slam.core.timing import StageTimer
from slam.dual.recovery.interface import RecoveryResult, RecoveryTask, RecoveryThread
from slam.runtime.backend import ExecutionMode
from slam.runtime.worker import Worker


@dataclass(frozen=True)
class ThreadOutcome:
    """Outcome of a finished recovery thread.

    Attributes:
        number: position of the thread, from 1.
        name: kind of the thread.
        result: its result.
        cpu_ms: CPU milliseconds of the run.
        ends_s: the time at which it counts as ended, in lockstep.
        is_last: no thread comes after it.
    """

    number: int
    name: str
    result: RecoveryResult
    cpu_ms: float
    ends_s: float
    is_last: bool


class RecoveryScheduler:
    """Runs the recovery threads in order.

    Args:
        mode: see the module.
        exhaustive: run every thread, even after one has succeeded.
    """

    def __init__(self, mode: ExecutionMode, exhaustive: bool) -> None:
        self._exhaustive = exhaustive
        self._outcomes: deque[ThreadOutcome] = deque()
        self._worker = Worker("recovery") if mode is ExecutionMode.THREADED else None

    def start(self, threads: Sequence[RecoveryThread], tasks: Sequence[RecoveryTask], stamp_s: float) -> None:
        """Start the threads.

        Args:
            threads: in the order in which they run.
            tasks: one for each; they share nothing that a thread changes.
            stamp_s: the current time.
        """
        job = self._run(threads, tasks, stamp_s)
        if self._worker is None:
            self._outcomes.extend(job)
        else:
            self._worker.submit(lambda: self._outcomes.extend(job))

    def ended(self, stamp_s: float) -> Iterator[ThreadOutcome]:
        """Yield each finished thread once.

        Raises:
            Exception: the exception of a thread.
        """
        if self._worker is not None:
            self._worker.check()
        while self._outcomes and (self._worker is not None or self._outcomes[0].ends_s <= stamp_s):
            yield self._outcomes.popleft()

    def rest(self) -> Iterator[ThreadOutcome]:
        """Wait for all threads, then yield those not yielded yet.

        Raises:
            Exception: the exception of a thread.
        """
        if self._worker is not None:
            self._worker.drain()
        while self._outcomes:
            yield self._outcomes.popleft()

    def close(self) -> None:
        """Stop the worker thread, if there is one."""
        if self._worker is not None:
            self._worker.close()

    def _run(
        self, threads: Sequence[RecoveryThread], tasks: Sequence[RecoveryTask], stamp_s: float
    ) -> Iterator[ThreadOutcome]:
        for number, (thread, task) in enumerate(zip(threads, tasks, strict=True), start=1):
            timer = StageTimer()
            with timer("recovery"):
                result = thread.run(task)
            stamp_s += thread.cost.seconds(result)
            is_last = number == len(threads) or (result.success and not self._exhaustive)
            yield ThreadOutcome(number, thread.name, result, timer.cpu_ms["recovery"], stamp_s, is_last)
            if is_last:
                return
