"""The two recovery threads of the paper's text: kinds ``paper_orb`` and ``paper_sift``.

They run on the system's corners, tracking, mapping and new map. Refinement by SIFT and ORB together and SIFT
in the bundle adjustment stay, which the text does not have.

Source: paper, Sec. III-B, III-C and Algorithm 1.
"""

from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.sift import SiftRecoveryConfig
from dslab.slam.tracking.doubt import DoubtConfig

# One similarity, to which the matches need not fit by any share.
_FUSION = FusionConfig(confirmations=1, min_share=0.0, min_matches=20)
_NO_DOUBT = DoubtConfig(min_share=0.0, nearer=0.0, slower=0.0)


def paper_orb_config() -> RecoveryConfig:
    """Settings of thread 1: ORB-SLAM, backward, to the first frame that fails."""
    return RecoveryConfig(
        max_unusable_s=0.0,
        whole_buffer=True,
        at_once=True,
        fusion=_FUSION,
        doubt=_NO_DOUBT,
    )


def paper_sift_config() -> SiftRecoveryConfig:
    """Settings of thread 2: each frame against its neighbour, SIFT with its published threshold."""
    return SiftRecoveryConfig(
        max_unusable_s=0.0,
        whole_buffer=True,
        at_once=True,
        fusion=_FUSION,
        doubt=_NO_DOUBT,
        contrast=0.04,
    )
