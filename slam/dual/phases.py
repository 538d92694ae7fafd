"""Where Dual-SLAM stands with the current map, a type each, with what it owns. Source: paper, Sec. III.

Recoveries run beside any of them.
"""

from dataclasses import dataclass, field

from dslab.slam.core.frame import Frame
from dslab.slam.map.map import Map


@dataclass(frozen=True)
class Starting:
    """A first map is sought; there is nothing to recover."""

    recoverable = False


@dataclass(frozen=True)
class Tracking:
    """A map is tracked from which no recovery is due."""

    recoverable = False


@dataclass(frozen=True)
class Lost:
    """A new map is sought after a breakage; frames are sought in the saved maps too.

    Attributes:
        since: index of the frame of the breakage.
        recoverable: the buffer reaches a saved map: it is frozen, and the new map will be extended backward.
    """

    since: int
    recoverable: bool


@dataclass(frozen=True)
class Held(Lost):
    """The healthy map was cut: no map is sought until it is asked for."""


@dataclass(eq=False)
class Restarting:
    """A new map is tracked, from which a recovery starts as soon as the map is fit for it.

    Attributes:
        map: the new map.
        first, second: the two frames that it was initialized from.
        since, recoverable: as when tracking was lost.
        noise: of the frames tracked in it, see :class:`slam.core.frame.Frame`.
        starting: the recovery is about to start.
    """

    map: Map
    first: Frame
    second: Frame
    since: int
    recoverable: bool
    noise: list[float] = field(default_factory=list)
    starting: bool = False

    @property
    def is_due(self) -> bool:
        """True if its recovery is still to be asked for."""
        return self.recoverable and not self.starting


Phase = Starting | Tracking | Lost | Restarting
