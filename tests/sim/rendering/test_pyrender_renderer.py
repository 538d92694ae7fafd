"""pyrender and MuJoCo render the same frames; both live in one process."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import psutil
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from dslab.scenarios.errors import InputError
from dslab.scenarios.loading import load_scenario
from dslab.scenarios.spec import Scenario
from dslab.sim.frame_plan import render_backend
from dslab.sim.motion import plan_motion
from dslab.sim.rendering.mujoco_renderer import MujocoRenderer
from dslab.sim.rendering.pyrender_renderer import PyrenderRenderer
from dslab.sim.rendering.renderers import RENDERERS, load_renderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.worlds import build_world, layout
from dslab.sim.worlds.base import Surface, WorldModel

CAMERA = Intrinsics(200, 150, 151.0, 163.0, 91.3, 80.7, 30.0)
VGA = Intrinsics(640, 480, 483.2, 521.6, 292.2, 258.2, 30.0)
FRAMES = 6
WORLDS = {
    "room": ("clean-room", {"length_m": 7.0, "width_m": 6.0}),
    "corridor": ("clean-corridor", {"length_m": 20.0, "turns": 1}),
    "city": ("clean-city", {"length_m": 120.0, "turns": 0}),
}
KINDS = {
    **{name: changes for name, (_, changes) in WORLDS.items()},
    "building": {"floors": 2, "length_m": 18.0},
    "warehouse": {"length_m": 14.0, "aisles": 2},
    "field": {"size_m": 40.0},
    "motorway": {"length_m": 200.0},
}


def rendered_in_turn(scenario: Scenario, changes: dict, camera: Intrinsics) -> list[list[np.ndarray]]:
    """Frames, depths and surfaces (FRAMES, H, W) of a world by MuJoCo and by pyrender, rendered in turn."""
    spec = scenario.world.model_copy(update=changes)
    world, duration_s = build_world(spec, 3), 20.0
    motion = plan_motion(layout(spec, 3), scenario.trajectory, duration_s, 3)
    renderers = [MujocoRenderer(world, camera), PyrenderRenderer(world, camera)]
    rendered = [
        [(*r.render(T), r.render_surface_ids(T)) for r in renderers]
        for T in motion.T_world_cam(np.linspace(0.5, duration_s - 0.5, FRAMES))
    ]
    for renderer in renderers:
        renderer.close()
    return [[np.stack(images) for images in zip(*by, strict=True)] for by in zip(*rendered, strict=True)]


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=() if name == "room" else pytest.mark.slow) for name in WORLDS],
)
def seen(request):
    """What both renderers show of a world."""
    name, changes = WORLDS[request.param]
    return rendered_in_turn(load_scenario(name), changes, CAMERA)


def inner(ids: np.ndarray) -> np.ndarray:
    """(N, H, W) bool: pixels whose neighbours show the same surface."""
    return maximum_filter(ids, (1, 3, 3)) == minimum_filter(ids, (1, 3, 3))


class TestAgreement:
    def test_surfaces_differ_only_at_their_edges(self, seen):
        (_, depth, ids), (_, other_depth, other) = seen
        differ = ids != other
        assert len(np.unique(ids)) > 30
        assert differ.mean() < 2e-3
        # Either of two surfaces in one plane may show.
        apart = np.abs(depth - other_depth) > 1e-4
        assert not (differ & apart & inner(ids) & inner(other)).any()

    def test_gray_is_the_same_to_a_level(self, seen):
        (gray, _, ids), (other, _, other_ids) = seen
        difference = np.abs(gray.astype(int) - other)
        assert gray.std() > 20
        assert difference.mean() < 0.05
        assert np.percentile(difference, 99) == 0
        same = ids == other_ids
        # A surface's own folds are edges that the surface numbers do not show.
        assert (difference[same] > 1).mean() < 1e-4
        assert difference[same].mean() < 0.01

    def test_depth_is_the_same_to_a_millimetre(self, seen):
        (_, depth, ids), (_, other, other_ids) = seen
        np.testing.assert_array_equal(depth > 0, other > 0)
        same = (ids == other_ids) & (depth > 0)
        difference = np.abs(depth - other)
        assert (difference[same & (depth < 100)] > 1e-3).mean() < 1e-4
        assert np.median(difference[same]) < 1e-5
        # Single precision at the far end of a world.
        assert (difference[same] > 1e-3 + 3e-6 * depth[same]).mean() < 1e-4


@pytest.mark.slow
def test_frames_of_every_kind_of_world_agree_as_far_as_is_said():
    """Prints the figures of docs/scenarios.md: ``pytest -rP -k agree_as_far``."""
    off, deep = {}, {}
    for name, changes in KINDS.items():
        scenario = load_scenario(f"clean/{name}", seed=3)
        (gray, depth, _), (other, other_depth, _) = rendered_in_turn(scenario, changes, VGA)
        off[name] = (np.abs(gray.astype(int) - other) > 1).mean()
        near = (depth > 0) & (depth < 100)
        deep[name] = (np.abs(depth - other_depth)[near] > 1e-3).mean()
        print(f"{name}: gray levels differ in {100 * off[name]:.3f} %, depths in {1e6 * deep[name]:.1f} ppm")
    # MuJoCo draws a motorway of few surfaces with four samples per pixel, pyrender with one.
    assert 0.01 < off.pop("motorway") < 0.05
    print(f"the six others: {100 * np.mean(list(off.values())):.3f} %")
    assert max(off.values()) < 1e-3 and max(deep.values()) < 1e-5


def board(seed: int = 0) -> WorldModel:
    texture = np.random.default_rng(seed).integers(0, 256, (96, 70), dtype=np.uint8)
    vertices = np.array([[-3.0, -3, 4], [3, -3, 4], [3, 3, 5], [-3, 3, 5]])
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    triangles = np.array([[0, 3, 2], [0, 2, 1]], np.int32)
    return WorldModel([Surface(vertices, triangles, uv, texture, "board")], 118.0)


def test_neither_renderer_leaves_a_trace_in_the_other():
    alone = []
    for kind in (MujocoRenderer, PyrenderRenderer):
        renderer = kind(board(), CAMERA)
        alone.append(renderer.render(np.eye(4)))
        renderer.close()
    mujoco, pyrender = MujocoRenderer(board(), CAMERA), PyrenderRenderer(board(), CAMERA)
    for _ in range(3):
        for renderer, before in zip((mujoco, pyrender), alone, strict=True):
            for image, expected in zip(renderer.render(np.eye(4)), before, strict=True):
                np.testing.assert_array_equal(image, expected)
            assert (renderer.render_surface_ids(np.eye(4)) == 0).any()
    # Closing one, and forgetting one without closing it, takes nothing from the other.
    pyrender.close()
    forgotten = PyrenderRenderer(board(1), CAMERA)
    del forgotten
    np.testing.assert_array_equal(mujoco.render(np.eye(4))[0], alone[0][0])
    mujoco.close()


def test_opening_and_closing_leaks_nothing():
    world = board()
    large = replace(
        world.surfaces[0], texture=np.random.default_rng(1).integers(0, 256, (2048, 2048), np.uint8)
    )
    process = psutil.Process()

    def cycle() -> int:
        renderer = PyrenderRenderer(replace(world, surfaces=[large] * 2), CAMERA)
        renderer.render(np.eye(4))
        renderer.close()
        return process.memory_info().rss

    before = [cycle() for _ in range(4)][-1]
    after = [cycle() for _ in range(10)][-1]
    # One kept texture per cycle would be 80 MB.
    assert after - before < 40e6


@pytest.mark.slow
def test_no_window_system_is_needed():
    windows = "{'pyglet', 'tkinter'} & set(sys.modules)"
    code = f"import sys, dslab.sim.rendering.pyrender_renderer; print({windows})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"


def test_an_unknown_renderer_is_one_line_that_names_the_known_ones():
    with pytest.raises(InputError) as error:
        load_renderer("blender")
    assert all(name in str(error.value) for name in ("--renderer", "blender", *RENDERERS))
    assert "\n" not in str(error.value)


def test_a_renderer_whose_library_is_missing_is_bad_input(monkeypatch):
    monkeypatch.setitem(RENDERERS, "third", "dslab.sim.no_such_module:Third")
    with pytest.raises(InputError, match="no_such_module"):
        load_renderer("third")


STRESSED = {
    "name": "short",
    "duration_s": 2.4,
    "world": {"kind": "corridor", "length_m": 9, "turns": 0},
    "camera": {
        "width_px": 120,
        "height_px": 90,
        "fx_px": 86,
        "fy_px": 84,
        "cx_px": 57,
        "cy_px": 46,
        "fps": 10,
        "distortion": {"model": "radtan", "k1": -0.25, "k2": 0.05},
    },
    "segments": [
        {"kind": "low_texture", "start_s": 0.3, "duration_s": 0.6, "contrast": 0.1},
        {"kind": "motion_blur", "start_s": 1.0, "duration_s": 0.4, "exposure_s": 0.08},
        {"kind": "fast_rotation", "start_s": 1.4, "duration_s": 0.6, "rate_degps": 60},
        {"kind": "fog", "start_s": 2.0, "duration_s": 0.4, "extinction_per_m": 0.5},
    ],
}


@pytest.mark.slow
def test_a_stressed_sequence_is_the_same_with_either_renderer(tmp_path):
    scenario = Scenario.model_validate(STRESSED)
    sequences = [
        render_sequence(scenario, 2, cache_dir=tmp_path, depth=True, backend=render_backend(name))
        for name in ("mujoco", "pyrender")
    ]
    assert [s.meta["renderer"] for s in sequences] == ["mujoco", "pyrender"]
    assert sequences[0].meta["gl"] == sequences[1].meta["gl"]
    assert sequences[1].meta["versions"]["pyrender"]
    # Each renderer has its own sequence in the cache.
    assert len([entry for entry in tmp_path.iterdir() if (entry / "gray.npy").exists()]) == 2
    gray, other = (np.stack([s.frames[k] for k in range(len(s))]).astype(int) for s in sequences)
    assert len(gray) == 24
    assert np.abs(gray - other).mean() < 0.1
    assert sequences[0].segments == sequences[1].segments
