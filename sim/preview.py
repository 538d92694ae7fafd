"""Single frames of a sequence, for quick looks at many scenarios."""

from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.segment_link import SegmentLink
from dslab.sim.frame_plan import RenderBackend, plan_frames, render_backend
from dslab.sim.imaging import ImagingChain, rendered
from dslab.sim.room import check_memory, check_room
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

    def expose_frames(self, indices: Many[int]) -> tuple[list[np.ndarray], np.ndarray, list[SegmentLink]]:
        """Return frames of the sequence, equal to those of the whole rendering.

        A frame depends on the plan, its number and its time, never on earlier frames: every degradation draws
        its random numbers by the frame's number.

        Args:
            indices: K indices into ``plan.stamps_s``, increasing.

        Returns:
            K images (H, W) uint8, (K,) float64 median length of their motion blur, pixels, and the segments
            on images as they have acted on these frames.
        """
        kept = np.zeros(len(self.plan.stamps_s), bool)
        kept[list(indices)] = True
        part, scenario = self.plan.only(kept), self.scenario
        camera = scenario.camera
        check_memory(scenario.name, len(indices), 2 * len(indices) * camera.width_px * camera.height_px)
        chain = ImagingChain(camera, scenario.segments, part, scenario.seed_of_noise)
        with rendered(self.world, chain.ideal, self.backend) as sharp:
            images = [image for image, _ in chain.images([*sharp, *chain.to_lens])]
        return images, chain.exposure.blur_px, chain.segments


def preview(scenario: Scenario, backend: RenderBackend | None = None) -> Preview:
    """Plan a sequence and build its world.

    Args:
        scenario: what happens, with its own seed.
        backend: worlds and renderer; None for MuJoCo.

    Raises:
        InputError: no GL, the world's sizes do not fit, or the plan does not fit into the memory.
    """
    check_room(scenario.name, scenario.frame_count, [])
    backend = backend or render_backend()
    plan, world = plan_frames(scenario, backend)
    return Preview(scenario, plan, world, backend)
