"""A map begun anew from the frames that it was made of, once the lens is known better."""

from collections.abc import Sequence
from dataclasses import dataclass

from dslab.slam.direct.pyramid import Rectifier
from dslab.slam.ldso.loss import reason_of_loss
from dslab.slam.ldso.odometry import Odometry
from dslab.slam.ldso.start import Starter, Waiting


@dataclass(frozen=True)
class Replayed:
    """A map as it would have become.

    Attributes:
        odometry: the map.
        left: rows of the keyframes that have left the window, in order.
    """

    odometry: Odometry
    left: list[int]


def replayed(
    frames: Sequence[Waiting], starter: Starter, rectifier: Rectifier, map_id: int
) -> Replayed | None:
    """Begin a map with the first of some frames as its first view, and track all of them.

    Args:
        frames: in order of time.
        starter: of the camera as it is known now; it has seen nothing yet.
        rectifier: of the same camera.
        map_id: id of the map.

    Returns:
        None if no map begins, or it is lost on the way.
    """
    config, odometry, left = starter.config.loss, None, []
    for item in frames:
        if odometry is None:
            odometry = starter.offer(item, map_id).odometry
            continue
        pyramid = rectifier.pyramid(item.image)
        tracked = odometry.track(pyramid, item.exposure)
        if tracked is None or reason_of_loss(tracked, odometry.uncertainty(tracked), config):
            if not odometry.pass_over():
                return None
            continue
        if odometry.take(item.frame, item.stamp_s, pyramid, tracked):
            odometry.add_keyframe(item.frame, item.stamp_s, item.image, pyramid, tracked)
            left += odometry.left
            if len(odometry.window.active) < config.least_points:
                return None
    return None if odometry is None else Replayed(odometry, left)
