"""Depth and pose against optical flow in every world, over several seeds."""

import numpy as np
import pytest
from world_views import CAMERA, SMALL, along, check_flow, flow_errors, length, moved

from sim.frame_plan import mujoco_backend


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("kind", SMALL)
def test_tracks_end_where_depth_and_pose_put_them(kind, seed):
    backend, spec = mujoco_backend(), SMALL[kind]
    route = backend.layout(spec, seed)
    renderer = backend.renderer(backend.build_world(spec, seed), CAMERA)
    firsts = [along(route, s) for s in np.linspace(0.1, 0.8, 5) * length(route)]
    errors = [flow_errors(renderer, first, moved(first, 0.05, 1.0)) for first in firsts]
    renderer.close()
    check_flow(errors, at_least=800)
