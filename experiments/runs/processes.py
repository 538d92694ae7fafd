"""Pools of spawned processes that end with this one, whatever ends it."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import Any


@contextmanager
def process_pool(
    workers: int, set_up: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of processes; if the block raises, they are killed, and what they did is lost.

    Args:
        workers: number of processes.
        set_up: called in each as it starts; a function of a module.
        arguments: of ``set_up``.
    """
    # Spawned, not forked: a process that holds a GL context must not fork.
    with ProcessPoolExecutor(workers, get_context("spawn"), _start, (set_up, arguments)) as pool:
        try:
            yield pool
        except BaseException:
            for process in active_children():
                process.kill()
            raise


def _start(set_up: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    # An interrupt reaches every process of the terminal, and only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    if set_up is not None:
        set_up(*arguments)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
