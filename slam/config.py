"""Settings of the base system."""

from dataclasses import replace

from dslab.slam.belief.config import BeliefConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.settings import setting, settings
from dslab.slam.features.orb import OrbConfig
from dslab.slam.initialization.initializer import InitializationConfig
from dslab.slam.loop_closing.detection import LoopClosingConfig
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.mapping.self_calibration import SelfCalibrationConfig
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.relocalization import RelocalizationConfig
from dslab.slam.tracking.rescue import RescueConfig


@settings
class SlamConfig:
    """Settings of the base system, one group per component."""

    orb: OrbConfig = setting(OrbConfig(), "extraction of features")
    initial_features: float = setting(
        5.0, "features of a frame before initialization over a tracked one's: small steps need many", gt=0
    )
    initialization: InitializationConfig = setting(InitializationConfig(), "first map, from two views")
    tracking: TrackingConfig = setting(TrackingConfig(), "poses of frames, and the choice of keyframes")
    mapping: LocalMappingConfig = setting(LocalMappingConfig(), "new points, culling, local adjustment")
    belief: BeliefConfig | None = setting(
        BeliefConfig(), "when a supposed place counts; null: as soon as it is supposed"
    )
    loops: LoopClosingConfig = setting(LoopClosingConfig(), "detection and correction of loops")
    relocalization: RelocalizationConfig = setting(RelocalizationConfig(), "poses after tracking was lost")
    rescue: RescueConfig = setting(RescueConfig(), "poses by intensities before a breakage is declared; off")
    self_calibration: SelfCalibrationConfig = setting(SelfCalibrationConfig(), "residual lens and shutter")
    min_map_keyframes: int = setting(5, "a map that breaks with no more keyframes is dropped instead of kept")


def default_config(camera: PinholeCamera) -> SlamConfig:
    """Published settings: 1,000 features up to 640x480, 2,000 for larger images such as KITTI's."""
    return replace(SlamConfig(), orb=OrbConfig(n_features=2000 if camera.is_large else 1000))
