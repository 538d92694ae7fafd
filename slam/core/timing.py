"""Stage timers: wall and CPU milliseconds of named steps of one frame."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

OTHER = "other"
"""Stage of the time outside all named stages."""


class StageTimer:
    """Adds up the time spent in named stages until it is read.

    Time between :meth:`begin` and :meth:`read` outside all stages goes to ``OTHER``, so that the stages sum
    up to the whole, less the time spent :meth:`apart`. Stages do not overlap.

    Attributes:
        ms: wall milliseconds per stage.
        cpu_ms: CPU milliseconds of this thread per stage.
    """

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}
        self.cpu_ms: dict[str, float] = {}
        self._began: tuple[float, float] | None = None
        self._apart_ms = self._apart_cpu_ms = 0.0

    def begin(self) -> None:
        """Start a frame with all stages at zero."""
        self.ms, self.cpu_ms = {}, {}
        self._apart_ms = self._apart_cpu_ms = 0.0
        self._began = _now_ms()

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        wall, cpu = _now_ms()
        try:
            yield
        finally:
            wall_end, cpu_end = _now_ms()
            self.ms[stage] = self.ms.get(stage, 0.0) + wall_end - wall
            self.cpu_ms[stage] = self.cpu_ms.get(stage, 0.0) + cpu_end - cpu

    @contextmanager
    def apart(self) -> Iterator[None]:
        """Exclude time that is measured elsewhere; must not contain a stage."""
        wall, cpu = _now_ms()
        try:
            yield
        finally:
            wall_end, cpu_end = _now_ms()
            self._apart_ms += wall_end - wall
            self._apart_cpu_ms += cpu_end - cpu

    def read(self) -> tuple[dict[str, float], dict[str, float]]:
        """(wall, CPU) milliseconds per stage since the last call or :meth:`begin`; resets them."""
        if self._began is not None:
            wall, cpu = _now_ms()
            self.ms[OTHER] = wall - self._began[0] - self._apart_ms - sum(self.ms.values())
            self.cpu_ms[OTHER] = cpu - self._began[1] - self._apart_cpu_ms - sum(self.cpu_ms.values())
        result = self.ms, self.cpu_ms
        self.ms, self.cpu_ms, self._began = {}, {}, None
        return result


def _now_ms() -> tuple[float, float]:
    """Wall and CPU time of this thread."""
    return 1e3 * time.perf_counter(), 1e3 * time.thread_time()
