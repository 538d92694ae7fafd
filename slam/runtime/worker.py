"""Worker thread that runs jobs in order and passes exceptions on."""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable

# Python lets a thread that computes go on for 5 ms before another gets its turn. A frame asks for it after
# each kernel: beside a recovery it took 1.4 times as long.
_SWITCH_S = 5e-4


class Worker:
    """One background thread with a job queue.

    The first one shortens the time after which Python's threads take turns, for the whole process.

    An exception in a job stops the thread; it is raised again in the caller's next call. An instance belongs
    to one owner, who must call :meth:`close`.

    Args:
        name: name of the thread in debuggers.
        niceness: added to that of the process, so that other threads come first where cores are few; on Linux
            only, elsewhere without effect.
    """

    def __init__(self, name: str, niceness: int = 0) -> None:
        sys.setswitchinterval(min(sys.getswitchinterval(), _SWITCH_S))
        self._niceness = niceness
        self._jobs: deque[Callable[[], None]] = deque()
        self._changed = threading.Condition()
        self._busy = False
        self._closing = False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def pending(self) -> int:
        """Number of jobs that wait or run."""
        with self._changed:
            return len(self._jobs) + self._busy

    def submit(self, job: Callable[[], None]) -> None:
        """Queue a job. Raises the exception of an earlier one."""
        with self._changed:
            self._raise()
            self._jobs.append(job)
            self._changed.notify_all()

    def drain(self) -> None:
        """Wait until all jobs are done. Raises the exception of a job."""
        with self._changed:
            self._changed.wait_for(lambda: self._error or not (self._jobs or self._busy))
            self._raise()

    def check(self) -> None:
        """Raise the exception of a job, if there is one."""
        with self._changed:
            self._raise()

    def close(self) -> None:
        """Stop the thread after the running job; waiting jobs are dropped."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        if self._niceness and sys.platform == "linux":  # where a thread has a niceness of its own
            this = threading.get_native_id()
            os.setpriority(os.PRIO_PROCESS, this, os.getpriority(os.PRIO_PROCESS, this) + self._niceness)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._jobs)
                if self._closing:
                    return
                job, self._busy = self._jobs.popleft(), True
            try:
                job()
            except BaseException as error:
                with self._changed:
                    self._error, self._busy = error, False
                    self._jobs.clear()
                    self._changed.notify_all()
                return
            with self._changed:
                self._busy = False
                self._changed.notify_all()
