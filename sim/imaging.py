"""The imaging chain: from a frame plan to images, through one list of links.

The links act in the order of the light: the world is rendered through its haze, then act segments between
surfaces and shutter, the open shutter, segments with an exposure of their own, and the lens. Behind it come
softness, segments on lens and sensor, tone curve, noise, and segments on the encoder.
"""

import hashlib
from collections.abc import Iterator
from collections.abc import Sequence as Many
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from dslab.scenarios.spec import Camera, Segment
from dslab.sim.degradations.base import FramePlan, Stage
from dslab.sim.degradations.fog import HazeLink
from dslab.sim.degradations.segment_link import segment_links
from dslab.sim.frame_plan import RenderBackend, taking_intrinsics
from dslab.sim.link import NO_IMAGE, Link, Shutter, View, fold
from dslab.sim.rendering.renderer import Renderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import Lens
from dslab.sim.sensors.exposure import Exposure
from dslab.sim.sensors.sensor import sensor_links
from dslab.sim.sequence import FrameSource
from dslab.sim.worlds.base import WorldModel

MOST_SHARED_BYTES = 64_000_000
"""Size of the exposed frames that are shared; those used longest ago are dropped."""


class ImagingChain:
    """All links of a plan but those that give the sharp frames.

    Args:
        camera: of the scenario.
        segments: of the scenario; those that act on images become links.
        plan: with every segment applied.
        seed: root seed of noise and segments.

    Attributes:
        ideal: intrinsics without distortion, through which sharp frames are taken.
        segments: a link for each segment on images, in order of action.
        exposure: the open shutter.
        to_lens: the links from sharp frames to those that come through the lens.
        behind_lens: the links from there to the stored frames; they know neither depth nor motion.
    """

    def __init__(self, camera: Camera, segments: Many[Segment], plan: FramePlan, seed: int) -> None:
        own = taking_intrinsics(camera)
        lens = None if own.is_pinhole else Lens(own)
        soft, developed = sensor_links(camera, seed)
        self._plan = plan
        self.ideal = lens.ideal if lens else own
        self.segments = segment_links(segments, own, plan.stamps_s, seed, self.ideal)
        self.exposure = Exposure(self.ideal, len(plan.stamps_s))
        at = {stage: [link for link in self.segments if link.kind.stage is stage] for stage in Stage}
        self.to_lens: list[Link] = [*at[Stage.SCENE], self.exposure, *at[Stage.READOUT]]
        self.to_lens += [lens] if lens else []
        self.behind_lens: list[Link] = [*soft, *at[Stage.LENS], *at[Stage.SENSOR]]
        self.behind_lens += [*developed, *at[Stage.ENCODER]]

    def images(self, source: Many[Link]) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
        """Yield every frame of the plan, and its depth if the source knows it.

        Args:
            source: links that give the frames as they come through the lens.
        """
        for taken in _views(self._plan):
            image, view = fold(source, NO_IMAGE, taken)
            image, _ = fold(self.behind_lens, image, replace(view, depth_m=None, motion=None))
            yield image, view.depth_m


@contextmanager
def rendered(world: WorldModel, camera: Intrinsics, backend: RenderBackend) -> Iterator[list[Link]]:
    """Yield the links that render sharp frames of a world through its haze; GL is freed at the end.

    Args:
        world: as the segments on it have left it.
        camera: intrinsics without distortion.
        backend: for the renderer.
    """
    renderer = backend.renderer(world, camera)
    try:
        yield [_Rendering(renderer), *([HazeLink(camera, world.haze)] if world.haze else [])]
    finally:
        renderer.close()


class _Rendering:
    """Sharp frames and their depth, at the centre of the exposure."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        assert view.shutter is not None
        image, depth_m = self._renderer.render(view.shutter.T_world_mid)
        return image, replace(view, depth_m=depth_m)


@dataclass(frozen=True)
class KeptExposures:
    """Frames as they have come through the lens before, by their number: a link in the place of those to it.

    Attributes:
        frames: N frames (H, W) uint8, none of them dropped.
        blur_px: (N,) median length of their motion blur.
        view_share: (N, S) share of the view of every surface; see ``FramePlan``.
        measures: (N,) measure of every segment on images that has acted.
    """

    frames: FrameSource
    blur_px: np.ndarray
    view_share: np.ndarray
    measures: dict[Segment, np.ndarray]

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        return self.frames[view.frame], view

    def measure(self, chain: ImagingChain, plan: FramePlan) -> None:
        """Say what the links would have measured in whose place the frames are."""
        chain.exposure.blur_px[:] = self.blur_px[plan.frame]
        for link in chain.segments:
            if link.segment in self.measures:
                link.measure[:] = self.measures[link.segment][plan.frame]


_shared: dict[bytes, tuple[np.ndarray, float]] = {}


class SharedExposures:
    """Links up to the lens, whose frames are shared by sequences that differ in other frames only.

    Outside the stress the cells of an experiment see the same: of a sequence with other segments only the
    frames that these touch are rendered and exposed anew.

    Args:
        links: those that give the frames as they come through the lens.
        chain: the chain they belong to.
        key: of all that the frames depend on besides poses, how the world looks, and segments on images.
        plan: how the world's surfaces look.
    """

    def __init__(self, links: Many[Link], chain: ImagingChain, key: str, plan: FramePlan) -> None:
        self._links, self._exposure = links, chain.exposure
        self._acting = [link for link in chain.segments if link.kind.stage < Stage.LENS]
        looks = (plan.contrast, plan.texture_of, plan.period_m)
        self._world = key.encode() + b"".join(values.tobytes() for values in looks)

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        if any(link.strength[view.index] for link in self._acting):
            return fold(self._links, image, view)
        assert view.shutter is not None
        key = hashlib.sha256(self._world + b"".join(pose.tobytes() for pose in view.shutter)).digest()
        if found := _shared.pop(key, None):
            image, self._exposure.blur_px[view.index] = found
        else:
            image, view = fold(self._links, image, view)
            image.flags.writeable = False
        _shared[key] = image, float(self._exposure.blur_px[view.index])
        while len(_shared) * image.nbytes > MOST_SHARED_BYTES:
            del _shared[next(iter(_shared))]
        return image, view


def _views(plan: FramePlan) -> Iterator[View]:
    """Yield what is known of every frame of a plan before it is rendered."""
    half_s = plan.exposure_s / 2
    T_world_mid = plan.motion.T_world_cam(plan.stamps_s)
    T_mid_world = np.linalg.inv(T_world_mid)
    T_mid_open = T_mid_world @ plan.motion.T_world_cam(plan.stamps_s - half_s)
    T_mid_close = T_mid_world @ plan.motion.T_world_cam(plan.stamps_s + half_s)
    for index, frame in enumerate(plan.frame.tolist()):
        yield View(
            frame,
            float(plan.stamps_s[index]),
            motion=plan.motion,
            exposure_s=float(plan.exposure_s[index]),
            index=index,
            shutter=Shutter(T_world_mid[index], T_mid_open[index], T_mid_close[index]),
        )
