"""Feeding frames in real time, with late ones dropped."""

import time
from typing import Any

import numpy as np

from dslab.scenarios.errors import notice
from dslab.sim.sequence import Sequence

MOST_WAIT_S = 10.0
"""Longest wait between two frames, unless the sequence is slower throughout."""


class RealTime:
    """Feeds the frames of a sequence at the pace of their stamps, as a camera would.

    The first frame is due when it is requested. A frame whose turn comes more than one frame interval after
    it was due is dropped, since the camera has the next one by then. This is a queue of one image, in which
    the newest replaces an older one, as in ORB-SLAM's drivers of live cameras. Its drivers of recorded
    sequences never drop frames and hence are not real-time. A gap is waited for no longer than it takes any
    system to end what it has begun.

    Args:
        sequence: the frames to feed; its median frame interval is the allowed delay.
        clock: has ``perf_counter`` and ``sleep``, as the module ``time``.
    """

    def __init__(self, sequence: Sequence, clock: Any = time) -> None:
        self._clock = clock
        steps_s = np.diff(sequence.stamps_s)
        self._interval_s = float(np.median(steps_s)) if len(steps_s) else 1.0 / sequence.camera.fps
        longest_s = max(MOST_WAIT_S, 2 * self._interval_s)
        if (steps_s > longest_s).any():
            gap = int(np.argmax(steps_s))
            said = (
                f"frame {gap + 1} comes {steps_s[gap]:.0f} s after the one before; {longest_s:g} s are waited"
            )
            notice(sequence.name, said)
        self._after_s = np.concatenate([[0.0], np.minimum(steps_s, longest_s).cumsum()])
        self._started_s: float | None = None

    def is_late(self, frame: int) -> bool:
        """True if a frame is too late to be fed."""
        return self._clock.perf_counter() - self._due_s(frame) > self._interval_s

    def wait_for(self, frame: int) -> None:
        """Wait until a frame is due."""
        self._clock.sleep(max(0.0, self._due_s(frame) - self._clock.perf_counter()))

    def _due_s(self, frame: int) -> float:
        after_s = float(self._after_s[frame])
        started_s = self._clock.perf_counter() - after_s if self._started_s is None else self._started_s
        self._started_s = started_s
        return started_s + after_s
