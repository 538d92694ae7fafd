"""Exact depth of a scenario's world in small images, cheap enough for hundreds of poses."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from dslab.scenarios.spec import Camera, Scenario
from dslab.sim.cache import FolderCache
from dslab.sim.frame_plan import RenderBackend, ideal_camera, render_backend, taking_intrinsics
from dslab.sim.io.raw import stored_array
from dslab.sim.provenance import entry_key
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds.base import Surface, WorldModel

THUMBNAIL_WIDTH_PX = 80

DepthOf = Callable[[np.ndarray], np.ndarray]
"""Depth (h, w) float32, metres along the optical axis, 0 for no surface, at a pose T_world_cam (4, 4)."""


def thumbnail_camera(camera: Camera) -> Intrinsics:
    """The small pinhole camera that holds all that a scenario's sees."""
    return ideal_camera(taking_intrinsics(camera)).scaled(THUMBNAIL_WIDTH_PX)


@contextmanager
def depth_renderer(
    scenario: Scenario,
    camera: Intrinsics,
    *,
    cache_dir: Path | None = None,
    backend: RenderBackend | None = None,
) -> Iterator[DepthOf]:
    """Yield exact depth in a scenario's world as a function of the pose.

    The world is static: objects that segments let move are not in it. The same scenario and poses give the
    same bytes on one machine and GL driver.

    Args:
        scenario: its world and its seed.
        camera: a small one, as of ``thumbnail_camera``.
        cache_dir: folder of the cache; None for the default one. It keeps the shape of the world, as only
            the textures make it slow to build.
        backend: worlds and renderer; None for MuJoCo.

    Raises:
        InputError: no GL, the world's sizes do not fit, or the cache cannot be written.
    """
    backend = backend or render_backend()
    renderer = backend.renderer(_bare_world(scenario, backend, FolderCache(cache_dir)), camera)
    try:
        yield lambda T_world_cam: renderer.render(T_world_cam)[1]
    finally:
        renderer.close()


def _bare_world(scenario: Scenario, backend: RenderBackend, store: FolderCache) -> WorldModel:
    """The world as one surface without texture."""
    # Only the world and its seed shape it.
    seed = scenario.seed_of_world
    bare = Scenario(name="world_shape", world=scenario.world, seed=seed)
    key = entry_key(bare, backend, world_shape=True)
    shape = store.load(key, _stored_shape)
    if shape is None:
        with store.create(key) as folder:
            _store_shape(folder, backend.build_world(scenario.world, seed).surfaces)
        shape = _stored_shape(store.root / key)
    vertices, triangles = shape
    blank = np.zeros((2, 2), np.uint8)
    surface = Surface(vertices, triangles, np.zeros((len(vertices), 2)), blank, "world")
    return WorldModel([surface], 0.0, np.ones(1))


def _store_shape(folder: Path, surfaces: list[Surface]) -> None:
    firsts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    triangles = [surface.triangles + first for surface, first in zip(surfaces, firsts[:-1], strict=True)]
    # The renderers take single precision.
    np.save(folder / "vertices_m.npy", np.concatenate([s.vertices for s in surfaces]).astype(np.float32))
    np.save(folder / "triangles.npy", np.concatenate(triangles).astype(np.int32))


def _stored_shape(entry: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (T, 3) int32 of an entry.

    Raises:
        CorruptEntryError: the entry holds anything else.
    """
    vertices_m = stored_array(entry / "vertices_m.npy", (None, 3), np.float32)
    triangles = stored_array(entry / "triangles.npy", (None, 3), np.int32)
    return vertices_m.astype(np.float64), np.array(triangles)
