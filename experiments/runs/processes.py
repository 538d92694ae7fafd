"""Spawned processes that end with this one, whatever ends it: pools, and one for a single call."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed, wait
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import Any

_JOIN_S = 10.0
_KILL_AGAIN_S = 0.1


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
    before = set(active_children())
    # Spawned, not forked: a process that holds a GL context must not fork.
    with ProcessPoolExecutor(workers, get_context("spawn"), _start, (set_up, arguments)) as pool:
        try:
            yield pool
        except BaseException:
            _kill_others_than(before)
            raise


def call_in_process(function: Callable[..., Any], arguments: tuple[Any, ...], time_s: float) -> Any:
    """Call a function in a process of its own, which ends with the call.

    Args:
        function: of a module.
        arguments: which can be pickled, as the result.
        time_s: longest duration.

    Returns:
        Its result.

    Raises:
        TimeoutError: it is not done in time.
        ChildProcessError: its process has died.
        Exception: whatever it raises.
    """
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_call, args=(sender, function, arguments))
    process.start()
    sender.close()
    try:
        if not receiver.poll(time_s):
            raise TimeoutError(f"not done after {time_s:g} s")
        result, error = receiver.recv()
    except EOFError:
        process.join(_JOIN_S)
        raise ChildProcessError(f"its process has died (exit code {process.exitcode})") from None
    finally:
        process.kill()
        process.join()
        receiver.close()
    if error is not None:
        raise error
    return result


def side_by_side(workers: int, function: Callable[..., Any], calls: list[tuple[Any, ...]]) -> Iterator[Any]:
    """Make calls in threads, some at a time, and yield each result as it ends.

    If the caller ends early or a call raises, the rest is left out, and the processes under way are killed.

    Args:
        workers: number of calls at a time.
        function: called with the arguments of each; usually it calls :func:`call_in_process`.
        calls: arguments of each call.
    """
    before = set(active_children())
    with ThreadPoolExecutor(workers) as pool:
        running = [pool.submit(function, *arguments) for arguments in calls]
        try:
            for future in as_completed(running):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            # A thread may be about to start another process. Of a future that was never begun, wait() says
            # that it is not done, though it is cancelled.
            begun = [future for future in running if not future.cancelled()]
            while wait(begun, _KILL_AGAIN_S).not_done:
                _kill_others_than(before)
            raise


def _kill_others_than(before: set[BaseProcess]) -> None:
    """Kill the children that were started since; those of others stay."""
    for process in set(active_children()) - before:
        process.kill()


def _call(sender: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    _start(None, ())
    try:
        result, error = function(*arguments), None
    except Exception as raised:
        result, error = None, raised
    try:
        sender.send((result, error))
    except Exception as fault:  # what cannot be pickled is told in words
        sender.send((None, RuntimeError(f"{error or fault}")))


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
