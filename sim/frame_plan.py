"""From a scenario to its frame plan: all that decides the frames before one is rendered."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from dslab.scenarios.spec import Camera, Scenario, World
from dslab.sim.degradations.base import FramePlan, Stage
from dslab.sim.degradations.registry import FRAME_PLAN_KINDS, in_order_of_action
from dslab.sim.degradations.texture import with_repeated_texture
from dslab.sim.motion import plan_motion
from dslab.sim.motion.base import Motion
from dslab.sim.rendering.renderer import Renderer
from dslab.sim.rendering.renderers import DEFAULT_RENDERER, load_renderer
from dslab.sim.room import check_memory
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import Lens
from dslab.sim.worlds.base import Route, WorldModel

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, frames done and frames in all."""

Survey = Callable[[FramePlan], np.ndarray]
"""(N, S) float32 share of the view that each surface of the world fills in each frame of a plan."""

_SURVEY_WIDTH_PX = 80


@dataclass(frozen=True)
class RenderBackend:
    """The worlds and the renderer behind their interfaces.

    Attributes:
        layout: route through a world, from its spec and a seed.
        build_world: the world itself.
        renderer: renderer of a world through a camera without distortion.
        gl_info: names of the GL implementation.
        renderer_name: the name recorded with the frames.
    """

    layout: Callable[[World, int], Route]
    build_world: Callable[[World, int], WorldModel]
    renderer: Callable[[WorldModel, Intrinsics], Renderer]
    gl_info: Callable[[], dict[str, str]]
    renderer_name: str = DEFAULT_RENDERER


def render_backend(renderer: str = DEFAULT_RENDERER) -> RenderBackend:
    """The worlds of ``sim.worlds``, rendered by one of ``sim.rendering.renderers``.

    Raises:
        InputError: no such renderer, or it is not usable here.
    """
    from dslab.sim.rendering.gl_context import gl_info
    from dslab.sim.worlds import layout

    return RenderBackend(layout, _world, load_renderer(renderer), gl_info, renderer)


@lru_cache(maxsize=1)
def _world(spec: World, seed: int) -> WorldModel:
    """Build a world, or reuse the last one: units sharing a world are adjacent."""
    from dslab.sim.worlds import build_world

    world = build_world(spec, seed)
    for surface in world.surfaces:
        surface.texture.flags.writeable = False
    return world


def camera_intrinsics(camera: Camera) -> Intrinsics:
    """The intrinsics of a scenario's camera."""
    lens = camera.distortion
    pinhole = Intrinsics(
        camera.width_px,
        camera.height_px,
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        camera.fps,
    )
    return (
        pinhole if lens.model == "none" else replace(pinhole, distortion=lens.coefficients, model=lens.model)
    )


def taking_intrinsics(camera: Camera) -> Intrinsics:
    """The intrinsics with which frames are taken: with what a calibration, as in their files, leaves."""
    known = camera_intrinsics(camera)
    left = camera.residual
    return known if left is None else replace(known, distortion=(left.k1, left.k2, 0.0, 0.0, 0.0))


def quiet(step: str, done: int, total: int) -> None:
    """The progress of work that nobody watches."""


def plan_frames(
    scenario: Scenario, backend: RenderBackend, progress: Progress = quiet
) -> tuple[FramePlan, WorldModel]:
    """Return the frame plan with every segment applied, and the world as rendered."""
    world = backend.build_world(scenario.world, scenario.seed_of_world)
    survey = partial(_survey, world=world, camera=scenario.camera, backend=backend, progress=progress)
    plan = plan_in_world(scenario, backend, len(world.surfaces), survey)
    return plan, replace(with_repeated_texture(world, plan.texture_of, plan.period_m), contrast=plan.contrast)


def plan_in_world(
    scenario: Scenario,
    backend: RenderBackend,
    surfaces: int = 0,
    survey: Survey = lambda plan: plan.view_share,
) -> FramePlan:
    """Plan the frames of a world that need not be built.

    Args:
        scenario: what happens.
        backend: for the route.
        surfaces: number of surfaces of the world, S.
        survey: called once if a segment acts on the world.
    """
    stamps_s = np.arange(scenario.frame_count) / scenario.camera.fps
    route = backend.layout(scenario.world, scenario.seed_of_world)
    plan = FramePlan(
        stamps_s=stamps_s,
        motion=plan_motion(route, scenario.trajectory, scenario.duration_s, scenario.seed),
        exposure_s=np.full(len(stamps_s), scenario.camera.exposure_s),
        contrast=np.ones(surfaces),
        view_share=np.zeros((len(stamps_s), 0), np.float32),
        seed=scenario.seed,
    )
    acting = in_order_of_action(s for s in scenario.segments if s.kind in FRAME_PLAN_KINDS)
    for stage in Stage:
        segments = [s for s in acting if FRAME_PLAN_KINDS[s.kind].stage is stage]
        if stage is Stage.WORLD and segments:
            plan = replace(plan, view_share=survey(plan))
        for segment in segments:
            plan = FRAME_PLAN_KINDS[segment.kind].apply(plan, segment)
    return plan


def plan_path(scenario: Scenario, backend: RenderBackend) -> Motion:
    """Plan the camera's motion with its segments; nothing is built or rendered."""
    acting = (s for s in scenario.segments if s.kind in FRAME_PLAN_KINDS)
    turning = tuple(s for s in acting if FRAME_PLAN_KINDS[s.kind].stage is Stage.MOTION)
    moved = scenario.model_copy(update={"segments": turning})
    return plan_in_world(moved, backend).motion


def ideal_camera(camera: Intrinsics) -> Intrinsics:
    """The distortion-free camera through which a camera's frames are rendered."""
    return camera if camera.is_pinhole else Lens(camera).ideal


def _survey(
    plan: FramePlan, world: WorldModel, camera: Camera, backend: RenderBackend, progress: Progress
) -> np.ndarray:
    """View share of every surface in every frame, from small renderings; see ``Survey``."""
    small = camera_intrinsics(camera).scaled(_SURVEY_WIDTH_PX)
    lens = None if small.is_pinhole else Lens(small)
    poses = plan.motion.T_world_cam(plan.stamps_s)
    check_memory("view shares", len(poses), 4 * len(poses) * len(world.surfaces))
    shares = np.zeros((len(poses), len(world.surfaces)), np.float32)
    renderer = backend.renderer(world, lens.ideal if lens else small)
    try:
        for frame, T_world_cam in enumerate(poses):
            ids = renderer.render_surface_ids(T_world_cam)
            ids = lens.distort_labels(ids) if lens else ids
            # Index -1, no surface, is counted first and dropped.
            counts = np.bincount(ids.ravel() + 1, minlength=len(world.surfaces) + 1)[1:]
            shares[frame] = counts / ids.size
            progress("surveying", frame + 1, len(poses))
    finally:
        renderer.close()
    return shares
