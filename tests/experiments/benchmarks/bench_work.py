"""Work for the processes of the bench, in a module that is quick to import."""

import os
import time


def start_time(index: int):
    """Work for which the first process is ready a second before the second."""
    time.sleep(1.0 * index)

    def work() -> int:
        started_s = time.time()
        time.sleep(0.2)
        return round(1e3 * started_s)

    return work


def fail_in_one(index: int):
    if index == 1:
        raise ValueError("the second one")
    return lambda: 1


def which_process(index: int):
    return os.getpid
