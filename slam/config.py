"""Settings of the base system."""

from dataclasses import dataclass, field, replace

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.features.orb import OrbConfig
from dslab.slam.initialization.initializer import InitializationConfig
from dslab.slam.loop_closing.detection import LoopClosingConfig
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.mapping.self_calibration import SelfCalibrationConfig
from dslab.slam.tracking.probation import ProbationConfig
from dslab.slam.tracking.reach import ReachConfig
from dslab.slam.tracking.relocalization import RelocalizationConfig
from dslab.slam.tracking.rescue import RescueConfig
from dslab.slam.tracking.tracker import TrackingConfig


@dataclass(frozen=True)
class SlamConfig:
    """Settings of the base system, one group per component.

    Attributes:
        orb: extraction of features.
        initialization: the first map, from two views.
        tracking: poses of frames, and the choice of keyframes.
        mapping: new points, their culling, local bundle adjustment.
        loops: detection and correction of loops.
        rescue: poses by intensities where features do not track, before a breakage is declared; off.
        relocalization: poses of frames after tracking was lost.
        reach: how far the camera can have come since it was lost.
        probation: confirmation of these poses by the frames that follow.
        initial_features: features of a frame before initialization over those of a tracked one, as far as the
            image has room for them; many are needed to see parallax after small steps.
        self_calibration: residual distortion of the lens.
        min_map_keyframes: a map that breaks with no more keyframes is dropped instead of kept.
    """

    orb: OrbConfig = field(default_factory=OrbConfig)
    initial_features: float = 5.0
    initialization: InitializationConfig = field(default_factory=InitializationConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    mapping: LocalMappingConfig = field(default_factory=LocalMappingConfig)
    loops: LoopClosingConfig = field(default_factory=LoopClosingConfig)
    relocalization: RelocalizationConfig = field(default_factory=RelocalizationConfig)
    rescue: RescueConfig = field(default_factory=RescueConfig)
    self_calibration: SelfCalibrationConfig = field(default_factory=SelfCalibrationConfig)
    reach: ReachConfig = field(default_factory=ReachConfig)
    probation: ProbationConfig = field(default_factory=ProbationConfig)
    min_map_keyframes: int = 5


def default_config(camera: PinholeCamera) -> SlamConfig:
    """Published settings: 1,000 features up to 640x480, 2,000 for larger images such as KITTI's."""
    return replace(SlamConfig(), orb=OrbConfig(n_features=2000 if camera.is_large else 1000))
