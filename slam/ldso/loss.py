"""The rule by which direct tracking is declared lost.

A direct method aligns any image somehow. A frame tells nothing if it shows hardly any of the newest
keyframe's points, or if it does not look like them: patterns do not correlate with theirs, which no change of
brightness feigns and noise alone does not hide. Tracking is lost when the pose is not known, by what images
say and what is expected of the camera's motion (:mod:`slam.ldso.motion`): frames that tell nothing are passed
over, without a pose, for as long as it is.
"""

from dslab.slam.ldso.config import LossConfig
from dslab.slam.ldso.tracking import Tracked


def reason_of_loss(tracked: Tracked | None, uncertainty: float, config: LossConfig) -> str:
    """Why a frame is not tracked; empty if it is.

    Args:
        tracked: its alignment.
        uncertainty: largest standard deviation of its pose, in usual depths and rad.
        config: settings.
    """
    if tracked is None or tracked.visible < config.least_visible:
        return "too_little_in_view"
    if tracked.likeness < config.least_likeness:
        return "images_differ"
    return "" if uncertainty < config.max_uncertainty else "pose_unknown"
