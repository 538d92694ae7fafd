"""Pools without processes."""

import queue
from contextlib import nullcontext
from threading import Thread

from dslab.experiments.jobs.pool import Ended, Pool, error_line
from dslab.experiments.runs.ending import EndKind


def open_local_pool(task, settings=None):
    """In the place of ``open_pool``: a pool that runs each item at once, in this process."""
    return nullcontext(LocalPool(task))


def open_thread_pool(task, settings):
    """In the place of ``open_pool``: a pool of threads of this process."""
    return nullcontext(ThreadPool(task, settings.workers))


class LocalPool(Pool):
    """A pool that runs each item at once, in this process; what it raises may stand for the end of one."""

    def __init__(self, task):
        self._task = task
        self._ended = []

    @property
    def busy(self):
        return len(self._ended)

    def free(self):
        return [] if self._ended else ["here"]

    def start(self, item, worker):
        self._ended.append(self._end(item, worker))

    def wait(self, timeout_s):
        ended, self._ended = self._ended, []
        return ended

    def _end(self, item, worker):
        try:
            return Ended(item, worker, self._task(item))
        except ChildProcessError as end:
            return Ended(item, worker, fault=EndKind.CRASHED, message=str(end))
        except TimeoutError as end:
            return Ended(item, worker, fault=EndKind.TIMED_OUT, message=str(end))
        except Exception as error:
            return Ended(item, worker, error=error, message=error_line(error))


class ThreadPool(LocalPool):
    """A pool of threads."""

    def __init__(self, task, workers):
        super().__init__(task)
        self._free = [str(number) for number in range(workers)]
        self._queue, self._busy = queue.SimpleQueue(), 0

    @property
    def busy(self):
        return self._busy

    def free(self):
        return list(self._free)

    def start(self, item, worker):
        self._free.remove(worker)
        self._busy += 1
        Thread(target=lambda: self._queue.put(self._end(item, worker))).start()

    def wait(self, timeout_s):
        try:
            ended = self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return []
        self._free.append(ended.worker)
        self._busy -= 1
        return [ended]
