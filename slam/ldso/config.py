"""Settings of direct sparse odometry."""

from dslab.slam.core.settings import GREY, setting, settings
from dslab.slam.direct.selection import SelectionConfig


@settings
class PhotometricConfig:
    """Settings of residuals."""

    huber: float = setting(9.0, "residual beyond which it counts linearly", unit=GREY, gt=0)
    gradient_scale: float = setting(
        50.0, "gradient at which a residual counts half", unit="grey levels per px", gt=0
    )
    gain_sigma: float = setting(0.3, "expected logarithm of a keyframe's gain", gt=0)
    offset_sigma: float = setting(20.0, "expected offset of a keyframe's brightness", unit=GREY, gt=0)

    @property
    def affine_prior(self) -> tuple[float, float]:
        """Information on a and b in units of the residuals' variance."""
        return (self.huber / self.gain_sigma) ** 2, (self.huber / self.offset_sigma) ** 2


@settings
class DirectTrackingConfig:
    """Settings of the tracker."""

    iterations: int = setting(20, "most steps on a level")


@settings
class KeyframeConfig:
    """Settings of the decision for a keyframe."""

    translation: float = setting(0.04, "weight of the root mean square flow without rotation; 640x480")
    whole: float = setting(0.02, "weight of the root mean square flow with rotation; 640x480")
    brightness: float = setting(2.0, "weight of the absolute logarithm of the gain")
    most_error: float = setting(2.0, "error over that of the first frame after the last keyframe")


@settings
class WindowConfig:
    """Settings of the window of keyframes."""

    fewest: int = setting(5, "fewest keyframes that stay", ge=1)
    most: int = setting(7, "most keyframes that stay", ge=1)
    points: int = setting(2000, "points that are wanted")
    iterations: int = setting(6, "most Gauss-Newton steps")
    least_in_view: float = setting(
        0.05, "share of its points in the newest keyframe's view below which a keyframe leaves", le=1
    )
    margin_information: float = setting(50.0, "least information of a depth marginalised, not dropped")
    margin_weight: float = setting(0.25, "weight of what is marginalised", le=1)


@settings
class CornerConfig:
    """Settings of the points that are recognised."""

    window_px: int = setting(5, "side of the window over which gradients are summed", ge=1)
    least_gradient: float = setting(
        4.0, "least change of a corner in every direction", unit="grey levels per px"
    )
    apart_px: int = setting(5, "side of the window in which a corner is the strongest", ge=1)
    noise_px: float = setting(1.0, "standard deviation of a corner found again", gt=0)
    radius_px: float = setting(2.0, "half side of the search window in a later keyframe")
    around: int = setting(10, "keyframes, nearest in time, whose points are looked for")
    agreeing: float = setting(0.1, "largest relative difference of two depths of one corner")
    scale_weight: float = setting(
        0.03, "weight of a loop's scale beside 1 of its rotation: odometry keeps scale better"
    )


@settings
class LossConfig:
    """Settings of the rule by which a loss of tracking is declared."""

    least_visible: float = setting(0.15, "share of the newest keyframe's pixels that must be in view", le=1)
    least_likeness: float = setting(0.5, "correlation of views below which tracking is lost", le=1)
    max_uncertainty: float = setting(0.05, "rad or usual depths by which a pose may be unknown", gt=0)
    least_points: int = setting(100, "active points of the window below which tracking is lost")
    min_keyframes: int = setting(5, "a map that is lost with no more keyframes is dropped")


@settings
class LensConfig:
    """Settings of the estimate of what the calibration leaves of the lens."""

    every: int = setting(3, "keyframes between two windows that are read; 0: keep the lens as given")
    least_windows: int = setting(5, "number of windows read before anything is changed")
    least_significance: float = setting(18.5, "significance of a change: chi-square, 4 degrees of freedom")
    least_shift_px: float = setting(0.2, "least root mean square shift of the pixels by a change")
    most_share: float = setting(0.05, "largest shift over the corner's distance from the centre", le=1)
    usual_shift_px: float = setting(2.0, "root mean square shift by which calibrations are usually off", gt=0)
    most_replayed: int = setting(100, "frames kept until the first change, to begin a map anew")


@settings
class DsoConfig:
    """Settings of direct sparse odometry; those of its first map and its loops are the base's."""

    photometric: PhotometricConfig = setting(PhotometricConfig(), "residuals")
    tracking: DirectTrackingConfig = setting(DirectTrackingConfig(), "tracking of frames")
    keyframes: KeyframeConfig = setting(KeyframeConfig(), "decision for a keyframe")
    selection: SelectionConfig = setting(SelectionConfig(points=1500), "pixels whose depth is sought")
    window: WindowConfig = setting(WindowConfig(), "bundle adjustment and marginalisation")
    loss: LossConfig = setting(LossConfig(), "when tracking is lost")
    corners: CornerConfig = setting(CornerConfig(), "points that are recognised, with loops only")
    lens: LensConfig = setting(LensConfig(), "what the calibration leaves of the lens")
