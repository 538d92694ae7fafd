import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slam_scenes import CAMERA, VIEW

from dslab.slam.core.frame import Features, Frame, FrameFeatures, twist_between

NO_FEATURES = Features(
    np.empty((0, 2), np.float32),
    np.empty(0, np.int32),
    np.empty(0, np.float32),
    np.empty(0, np.float32),
    np.empty((0, 4), np.uint64),
)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (1e-7, 0.0, 0.0), (0.3, -0.5, 0.9), (0.0, 2.0, -1.5)])
def test_the_twist_between_frames_is_that_of_the_motion(turn):
    before, after = (Frame(FrameFeatures.build(i, 0.5 * i, NO_FEATURES, CAMERA, VIEW)) for i in range(2))
    before.T_cam_map = np.eye(4)
    before.T_cam_map[:3, :3] = Rotation.from_rotvec([0.4, 0.2, -0.1]).as_matrix()
    before.T_cam_map[:3, 3] = 1.0, 2.0, 3.0
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), (0.2, 0.0, -0.4)
    after.T_cam_map = motion @ before.T_cam_map
    expected = np.concatenate([np.array([0.2, 0.0, -0.4]) / 4.0, turn]) / 0.5
    assert twist_between(before, after, depth=4.0) == pytest.approx(expected, abs=1e-9)
