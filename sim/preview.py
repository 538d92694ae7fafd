"""Some frames of a sequence without the others, for a look at many scenarios in little time."""

import tempfile
from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.spec import Scenario
from sim.degradations.base import Shoot
from sim.degradations.chain import ImageChain
from sim.frame_plan import (
    Studio,
    camera_intrinsics,
    film,
    ideal_camera,
    mujoco_studio,
    plan_shoot,
    rendered_plates,
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
        studio: what renders.
    """

    scenario: Scenario
    shoot: Shoot
    world: WorldModel
    studio: Studio

    def film(self, indices: Many[int]) -> tuple[list[np.ndarray], np.ndarray]:
        """The very frames that the whole sequence has at some places.

        This holds because a frame depends on the plan, its own number and its own time, never on the frames
        before it: each kind of degradation draws its random numbers by the frame's number.

        Args:
            indices: K places among ``shoot.stamps_s``, rising.

        Returns:
            K images (H, W) uint8, and (K,) float64 median length of their motion blur, pixels.
        """
        kept = np.zeros(len(self.shoot.stamps_s), bool)
        kept[list(indices)] = True
        part, camera, seed = self.shoot.only(kept), self.scenario.camera, self.scenario.seed
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
            rendered_plates(self.world, camera, self.studio) as plates,
        ):
            blur_px = film(Path(folder), part, plates, camera, chain, False, lambda step, done, total: None)
            frames = RawFrames(Path(folder) / "gray.npy")
            return [frames[k] for k in range(len(frames))], blur_px


def preview(scenario: Scenario, studio: Studio | None = None) -> Preview:
    """Plan a sequence and build its world.

    Args:
        scenario: what happens, with its own seed.
        studio: what renders; None for MuJoCo.

    Raises:
        InputError: no GL, or the world's sizes do not fit.
    """
    studio = studio or mujoco_studio()
    shoot, world = plan_shoot(scenario, scenario.seed, studio, lambda step, done, total: None)
    return Preview(scenario, shoot, world, studio)
