"""Settings of direct sparse odometry."""

from dataclasses import dataclass, field

from dslab.slam.direct.selection import SelectionConfig


@dataclass(frozen=True)
class PhotometricConfig:
    """Settings of residuals.

    Attributes:
        huber: residual beyond which it counts linearly, of 255.
        gradient_scale: gradient per pixel at which a residual counts half.
        gain_sigma, offset_sigma: what is expected of a and b of a keyframe.
    """

    huber: float = 9.0
    gradient_scale: float = 50.0
    gain_sigma: float = 0.3
    offset_sigma: float = 20.0

    @property
    def affine_prior(self) -> tuple[float, float]:
        """Information on a and b in units of the residuals' variance."""
        return (self.huber / self.gain_sigma) ** 2, (self.huber / self.offset_sigma) ** 2


@dataclass(frozen=True)
class TrackingConfig:
    """Settings of the tracker.

    Attributes:
        cutoff: residual beyond which it counts as this, doubled while too many do.
        most_cutoff_factor: largest factor of it.
        most_saturated: share of such residuals that is too many.
        iterations: most steps on a level.
        good: error over the last frame's, up to which a guess of the motion is taken without trying others.
        usual_error: error, of 255, that is good in any case.
    """

    cutoff: float = 20.0
    most_cutoff_factor: float = 8.0
    most_saturated: float = 0.6
    iterations: int = 20
    good: float = 1.5
    usual_error: float = 3.0


@dataclass(frozen=True)
class KeyframeConfig:
    """Settings of the decision for a keyframe.

    Attributes:
        translation, whole: weights of the root of the mean squared flow without and with rotation, in the
            unit of an image of 640x480.
        brightness: weight of the absolute logarithm of the gain.
        most_error: error over that of the first frame after the last keyframe.
    """

    translation: float = 0.04
    whole: float = 0.02
    brightness: float = 2.0
    most_error: float = 2.0


@dataclass(frozen=True)
class ImmatureConfig:
    """Settings of points whose depth is being searched.

    Attributes:
        selection: of the pixels of a keyframe.
        most_share: longest search, of width plus height of the image.
        nearest, longest: where nothing is known of a point, the search goes on to this inverse depth over
            the usual one, at most to this multiple of ``most_share``: a long step shifts near points more.
        certain_px: length of an interval that needs no search.
        error_px, slope_error_px: error of a place found: the first, plus the second over the share of the
            squared gradient that lies along the line.
        most_error_px: largest of it.
        second_px: distance of the second best place, at least.
        outlier: mean residual of the pattern, of 255, beyond which nothing is found.
        slack: factor of it during the search.
        activated_px: length of the interval below which a point can be activated.
        quality: least residual of the second best place over the best.
        iterations: steps of the refinement of a depth at activation.
        least_information: on an inverse depth, for residuals of unit variance, for activation.
    """

    selection: SelectionConfig = field(default_factory=lambda: SelectionConfig(points=1500))
    most_share: float = 0.027
    nearest: float = 3.0
    longest: float = 4.0
    certain_px: float = 1.5
    error_px: float = 0.2
    slope_error_px: float = 0.2
    most_error_px: float = 10.0
    second_px: float = 2.0
    outlier: float = 12.0
    slack: float = 1.2
    activated_px: float = 8.0
    quality: float = 3.0
    iterations: int = 3
    least_information: float = 100.0


@dataclass(frozen=True)
class WindowConfig:
    """Settings of the window of keyframes.

    Attributes:
        fewest, most: keyframes that stay.
        points: points that are wanted.
        iterations: most Gauss-Newton steps.
        least_points: share of a keyframe's points still active below which it is marginalised.
        most_gain: absolute logarithm of the gain to the newest keyframe beyond which it is.
        margin_information: least information on an inverse depth that is marginalised, not dropped.
        margin_weight: weight of what is marginalised.
        outlier_quantile: share of the residuals of the newest keyframe on which the bound rests.
        outlier_factor: of the residual at that share.
        outlier_usual: residual, of 255, which the bound is averaged with.
    """

    fewest: int = 5
    most: int = 7
    points: int = 2000
    iterations: int = 6
    least_points: float = 0.05
    most_gain: float = 0.7
    margin_information: float = 50.0
    margin_weight: float = 0.25
    outlier_quantile: float = 0.7
    outlier_factor: float = 1.5
    outlier_usual: float = 9.2


@dataclass(frozen=True)
class CornerConfig:
    """Settings of the points that are recognised.

    Attributes:
        window_px: side of the window over which gradients are summed.
        least_gradient: change of intensity per pixel that a corner has at least in every direction.
        apart_px: side of the window in which it is the strongest.
        noise_px: standard deviation of a corner found again.
        radius_px: half side of the window in which a point is looked for in a later keyframe.
        around: keyframes, nearest in time, whose points are looked for.
        agreeing: largest relative difference of two depths of one corner.
        scale_weight: weight of a loop's scale in the pose graph, beside 1 of its rotation and translation and
            of all that odometry says: the depths of one place tell it worse than odometry keeps it.
    """

    window_px: int = 5
    least_gradient: float = 4.0
    apart_px: int = 5
    noise_px: float = 1.0
    radius_px: float = 2.0
    around: int = 10
    agreeing: float = 0.1
    scale_weight: float = 0.03


@dataclass(frozen=True)
class LossConfig:
    """Settings of the rule by which a loss of tracking is declared.

    Attributes:
        most_error: error, of 255, beyond which an image does not look like the map.
        error_factor: error over the usual one of the last second, likewise; the usual one is taken as
            at least ``least_error``.
        least_error: see there.
        least_visible: share of the newest keyframe's pixels that must be in view.
        most_saturated: share of their residuals beyond the cutoff.
        least_likeness: correlation of the views within the patterns.
        most_jump: step over the usual one, in position or angle.
        least_jump_depths, least_jump_deg: steps up to these are none.
        most_trade_deg: change of the motion from one frame to the next, as it moves the image's centre, up to
            which translation and rotation may change against each other.
        most_left: share of it that is left of both together, below which they do.
        least_points: active points of the window below which it is lost.
        min_keyframes: maps with no more are dropped.
    """

    most_error: float = 14.0
    error_factor: float = 3.0
    least_error: float = 4.0
    least_visible: float = 0.15
    most_saturated: float = 0.5
    least_likeness: float = 0.5
    most_jump: float = 8.0
    least_jump_depths: float = 0.1
    least_jump_deg: float = 5.0
    most_trade_deg: float = 1.2
    most_left: float = 0.5
    least_points: int = 100
    min_keyframes: int = 5


@dataclass(frozen=True)
class LensConfig:
    """Settings of the estimate of what the calibration leaves of the lens.

    Attributes:
        every: keyframes from one window that is read to the next; 0: the lens is taken as it is given.
        least_windows: number of them before anything is changed.
        least_significance: of a change; chi-square with 4 degrees of freedom, 18.5 by chance once in a
            thousand.
        least_shift_px: least root mean square shift of the pixels by a change.
        most_share: largest shift of a pixel over the distance of the image's corner from the centre.
        usual_shift_px: root mean square shift by which calibrations are usually off.
        most_replayed: frames that are kept until the first change; if a map is made of no more, it is begun
            anew from them then.
    """

    every: int = 3
    least_windows: int = 5
    least_significance: float = 18.5
    least_shift_px: float = 0.2
    most_share: float = 0.05
    usual_shift_px: float = 2.0
    most_replayed: int = 100


@dataclass(frozen=True)
class DsoConfig:
    """Settings of direct sparse odometry; its first map from two views and its loops have those of the base.

    Attributes:
        photometric: residuals.
        tracking: tracker.
        keyframes: decision for a keyframe.
        immature: points whose depth is being searched.
        window: bundle adjustment and marginalisation.
        loss: when tracking is lost.
        corners: points that are recognised, with loops only.
        lens: what the calibration leaves of the lens.
    """

    photometric: PhotometricConfig = field(default_factory=PhotometricConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    immature: ImmatureConfig = field(default_factory=ImmatureConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    corners: CornerConfig = field(default_factory=CornerConfig)
    lens: LensConfig = field(default_factory=LensConfig)
