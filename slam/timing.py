"""Stage timers: wall and CPU milliseconds of named steps of one frame."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class StageTimer:
    """Adds up the time spent in named stages until it is read.

    Attributes:
        ms: wall milliseconds per stage.
        cpu_ms: CPU milliseconds of this thread per stage.
    """

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}
        self.cpu_ms: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        wall, cpu = time.perf_counter(), time.thread_time()
        try:
            yield
        finally:
            self.ms[stage] = self.ms.get(stage, 0.0) + 1e3 * (time.perf_counter() - wall)
            self.cpu_ms[stage] = self.cpu_ms.get(stage, 0.0) + 1e3 * (time.thread_time() - cpu)

    def read(self) -> tuple[dict[str, float], dict[str, float]]:
        """(wall, CPU) milliseconds per stage since the last call; begins anew."""
        result = self.ms, self.cpu_ms
        self.ms, self.cpu_ms = {}, {}
        return result
