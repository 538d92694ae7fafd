"""Some frames of a sequence without the others, for a look at many scenarios in little time."""

import tempfile
from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.spec import Scenario
from sim.degradations.base import FramePlan
from sim.degradations.chain import ImageChain
from sim.frame_plan import (
    RenderBackend,
    camera_intrinsics,
    expose_frames,
    ideal_camera,
    mujoco_backend,
    plan_frames,
    rendered_clean_frames,
)
from sim.io.raw import RawFrames
from sim.worlds.base import WorldModel


@dataclass(frozen=True)
class Preview:
    """A sequence that is planned from its first frame to its last and filmed only where one looks.

    Attributes:
        scenario: what happens; its seed is the sequence's.
        shoot: the whole plan, with every segment applied.
        world: as the camera sees it.
        backend: what renders.
    """

    scenario: Scenario
    plan: FramePlan
    world: WorldModel
    backend: RenderBackend

    def expose_frames(self, indices: Many[int]) -> tuple[list[np.ndarray], np.ndarray]:
        """The very frames that the whole sequence has at some places.

        This holds because a frame depends on the plan, its own number and its own time, never on the frames
        before it: each kind of degradation draws its random numbers by the frame's number.

        Args:
            indices: K places among ``shoot.stamps_s``, rising.

        Returns:
            K images (H, W) uint8, and (K,) float64 median length of their motion blur, pixels.
        """
        kept = np.zeros(len(self.plan.stamps_s), bool)
        kept[list(indices)] = True
        part, camera, seed = self.plan.only(kept), self.scenario.camera, self.scenario.seed
        own = camera_intrinsics(camera)
        chain = ImageChain(
            self.scenario.segments,
            own,
            part.stamps_s,
            part.frame,
            seed,
            part.exposure_s,
            ideal_camera(own),
        )
        with (
            tempfile.TemporaryDirectory(prefix="dslab-") as folder,
            rendered_clean_frames(self.world, camera, self.backend) as clean_frames,
        ):
            blur_px = expose_frames(
                Path(folder), part, clean_frames, camera, chain, False, lambda step, done, total: None
            )
            frames = RawFrames(Path(folder) / "gray.npy")
            return [frames[k] for k in range(len(frames))], blur_px


def preview(scenario: Scenario, backend: RenderBackend | None = None) -> Preview:
    """Plan a sequence and build its world.

    Args:
        scenario: what happens, with its own seed.
        backend: what renders; None for MuJoCo.

    Raises:
        InputError: no GL, or the world's sizes do not fit.
    """
    backend = backend or mujoco_backend()
    plan, world = plan_frames(scenario, scenario.seed, backend, lambda step, done, total: None)
    return Preview(scenario, plan, world, backend)
