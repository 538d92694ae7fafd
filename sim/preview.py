"""Single frames of a sequence, for quick looks at many scenarios."""

from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.chain import ImageChain
from dslab.sim.frame_plan import (
    RenderBackend,
    expose_frames,
    ideal_camera,
    mujoco_backend,
    noise_seed,
    plan_frames,
    rendered_clean_frames,
    taking_intrinsics,
)
from dslab.sim.io.raw import RawFrames
from dslab.sim.room import check_memory, check_room
from dslab.sim.sensors.sensor import Sensor
from dslab.sim.unfinished import scratch_folder
from dslab.sim.worlds.base import WorldModel


@dataclass(frozen=True)
class Preview:
    """A fully planned sequence of which only chosen frames are rendered.

    Attributes:
        scenario: what happens; its seed is the sequence's.
        plan: the whole frame plan, with every segment applied.
        world: as rendered.
        backend: worlds and renderer.
    """

    scenario: Scenario
    plan: FramePlan
    world: WorldModel
    backend: RenderBackend

    def expose_frames(self, indices: Many[int]) -> tuple[list[np.ndarray], np.ndarray]:
        """Return frames of the sequence, equal to those of the whole rendering.

        A frame depends on the plan, its number and its time, never on earlier frames: every degradation draws
        its random numbers by the frame's number.

        Args:
            indices: K indices into ``plan.stamps_s``, increasing.

        Returns:
            K images (H, W) uint8, and (K,) float64 median length of their motion blur, pixels.
        """
        images, blur_px, _ = self.exposed(indices)
        return images, blur_px

    def exposed(self, indices: Many[int]) -> tuple[list[np.ndarray], np.ndarray, ImageChain]:
        """Return the same, and the segments on images as they have acted on these frames."""
        kept = np.zeros(len(self.plan.stamps_s), bool)
        kept[list(indices)] = True
        part, camera, seed = self.plan.only(kept), self.scenario.camera, self.scenario.seed
        own = taking_intrinsics(camera)
        check_memory(self.scenario.name, len(indices), 2 * len(indices) * own.width_px * own.height_px)
        chain = ImageChain(
            self.scenario.segments,
            own,
            part.stamps_s,
            part.frame,
            noise_seed(self.scenario, seed),
            part.exposure_s,
            ideal_camera(own),
        )
        sensor = Sensor(camera, noise_seed(self.scenario, seed))
        with (
            scratch_folder() as folder,
            rendered_clean_frames(self.world, camera, self.backend) as clean_frames,
        ):
            blur_px = expose_frames(
                folder, part, clean_frames, camera, sensor, chain, False, lambda step, done, total: None
            )
            shape = (len(part.frame), camera.height_px, camera.width_px)
            frames = RawFrames(folder / "gray.npy", shape, np.uint8)
            return [frames[k] for k in range(len(frames))], blur_px, chain


def preview(scenario: Scenario, backend: RenderBackend | None = None) -> Preview:
    """Plan a sequence and build its world.

    Args:
        scenario: what happens, with its own seed.
        backend: worlds and renderer; None for MuJoCo.

    Raises:
        InputError: no GL, the world's sizes do not fit, or the plan does not fit into the memory.
    """
    check_room(scenario.name, scenario.frame_count, [])
    backend = backend or mujoco_backend()
    plan, world = plan_frames(scenario, scenario.seed, backend, lambda step, done, total: None)
    return Preview(scenario, plan, world, backend)
