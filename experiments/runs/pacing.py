"""The pace at which frames are fed: as they are taken, or in real time with late ones dropped."""

import time
from typing import Protocol

import numpy as np

from sim.sequence import Sequence


class Clock(Protocol):
    """Where the time comes from."""

    def now_s(self) -> float:
        """Seconds since some fixed moment."""
        ...

    def wait_until(self, moment_s: float) -> None:
        """Return when ``now_s`` has reached the moment; at once if it has passed."""
        ...


class WallClock:
    """The time that passes for everyone."""

    def now_s(self) -> float:
        """Seconds since some fixed moment."""
        return time.perf_counter()

    def wait_until(self, moment_s: float) -> None:
        """Sleep until the moment."""
        time.sleep(max(0.0, moment_s - self.now_s()))


class RealTime:
    """Feeds the frames of a sequence at the pace of their stamps, as a camera would.

    The first frame is due when it is asked for. A frame whose turn comes more than one frame interval after
    it was due is dropped: the camera has the next one by then. So does a driver with a queue of one image, in
    which the newest takes the place of one not yet taken, as ORB-SLAM's drivers of live cameras do. Its
    drivers of recorded sequences drop nothing, however late: that is no real time.

    Args:
        sequence: the frames to come; its median frame interval is the one that counts.
        clock: the wall clock where None.
    """

    def __init__(self, sequence: Sequence, clock: Clock | None = None) -> None:
        self._stamps_s = sequence.stamps_s
        self._clock = clock or WallClock()
        steps_s = np.diff(sequence.stamps_s)
        self._interval_s = float(np.median(steps_s)) if len(steps_s) else 1.0 / sequence.camera.fps
        self._started_s: float | None = None

    def is_late(self, frame: int) -> bool:
        """Whether the turn of a frame comes too late for it to be fed."""
        return self._clock.now_s() - self._due_s(frame) > self._interval_s

    def wait_for(self, frame: int) -> None:
        """Return when a frame is due."""
        self._clock.wait_until(self._due_s(frame))

    def _due_s(self, frame: int) -> float:
        if self._started_s is None:
            self._started_s = self._clock.now_s() - float(self._stamps_s[frame] - self._stamps_s[0])
        return self._started_s + float(self._stamps_s[frame] - self._stamps_s[0])
