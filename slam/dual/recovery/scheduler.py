"""The recovery threads of one breakage, run one after another beside tracking.

In lockstep they are run at once, and each is said to have ended when its cost model says that it would have:
what comes of it does not depend on the load of the machine. Threaded they have a thread of their own.
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
    """A recovery thread that has ended.

    Attributes:
        number: from 1.
        name: of its kind.
        result: what it made of it.
        cpu_ms: what that took.
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
    """Runs the recovery threads.

    Args:
        mode: see the module.
        exhaustive: run every thread, also after one has succeeded.
    """

    def __init__(self, mode: ExecutionMode, exhaustive: bool) -> None:
        self._exhaustive = exhaustive
        self._outcomes: deque[ThreadOutcome] = deque()
        self._worker = Worker("recovery") if mode is ExecutionMode.THREADED else None

    def start(self, threads: Sequence[RecoveryThread], tasks: Sequence[RecoveryTask], stamp_s: float) -> None:
        """Set the threads going.

        Args:
            threads: in the order in which they run.
            tasks: one for each, sharing nothing that a thread changes.
            stamp_s: the time now.
        """
        job = self._run(threads, tasks, stamp_s)
        if self._worker is None:
            self._outcomes.extend(job)
        else:
            self._worker.submit(lambda: self._outcomes.extend(job))

    def ended(self, stamp_s: float) -> Iterator[ThreadOutcome]:
        """The threads that have ended by now, each told of once. Raises what a thread has raised."""
        if self._worker is not None:
            self._worker.check()
        while self._outcomes and (self._worker is not None or self._outcomes[0].ends_s <= stamp_s):
            yield self._outcomes.popleft()

    def rest(self) -> Iterator[ThreadOutcome]:
        """Wait for all threads; those not told of yet. Raises what a thread has raised."""
        if self._worker is not None:
            self._worker.drain()
        while self._outcomes:
            yield self._outcomes.popleft()

    def close(self) -> None:
        """End the thread."""
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
