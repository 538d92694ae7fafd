"""Speed and memory of the simulator: rendering, degrading from the cache, building a large world."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier
from pathlib import Path
from threading import BrokenBarrierError
from typing import Any

from dslab.experiments.jobs.pool import PoolSettings, open_pool, run_each
from dslab.experiments.runs.memory import peak_rss_mb
from dslab.sim.rendering.renderers import check_renderer
from dslab.sim.unfinished import scratch_folder

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 640, 480, 420.0
LARGE_CITY_M = 1000.0
SCENES: dict[str, tuple[str, float | None]] = {
    "city": ("clean-city", None),
    "corridor": ("clean-corridor", None),
    "large_city": ("clean-city", LARGE_CITY_M),
}
"""Rendered scenes by name: the scenario and the length of its world; None for its own."""
BLUR_EXPOSURE_S = 0.02
TARGETS = {"rendered_per_s": 60.0, "degraded_per_s": 150.0, "build_s": 5.0, "peak_rss_mb": 1536.0}
"""Targets on two cores: least frames per second, most time and memory."""

_SET_UP_TIMEOUT_S = 600

Work = Callable[[], int]
"""The measured work; returns the number of frames made."""


@dataclass(frozen=True)
class Lap:
    """Measurement of one process.

    Attributes:
        frames: number of frames made.
        wall_s: elapsed time.
        cpu_s: CPU time of all threads of the process.
        peak_rss_mb: largest resident memory of the process so far, including set-up.
    """

    frames: int
    wall_s: float
    cpu_s: float
    peak_rss_mb: float


def bench_sim(
    processes: int = 2,
    frames: int = 120,
    progress: Callable[[str, int, int], None] | None = None,
    renderer: str = "mujoco",
) -> dict[str, Any]:
    """Measure the simulator at 640x480 with several processes at once, each with its own GL context.

    Every process sets up (imports, world, renderer, kernels) and waits for the others, so that all start
    together; set-up is not measured.

    Args:
        processes: number of processes.
        frames: number per process and figure.
        progress: called with (step, done, total).
        renderer: one of ``sim.rendering.renderers``.

    Returns:
        JSON-like figures: under ``rendered`` (by scene) and ``degraded`` (``sharp`` and ``blurred``) those of
        ``rates``; under ``build`` the seconds for a city of a kilometre; under ``asked`` the targets.
    """
    check_renderer(renderer)
    show = progress or (lambda step, done, total: None)
    steps = [
        (f"render {name}", _prepare_render, (*scene, processes, frames, renderer))
        for name, scene in SCENES.items()
    ]
    with scratch_folder() as cache:
        steps += [
            ("degrade", _prepare_degrade, (frames, 0.0, cache, renderer)),
            ("degrade and blur", _prepare_degrade, (frames, BLUR_EXPOSURE_S, cache, renderer)),
        ]
        figures = {}
        for done, (name, prepare, arguments) in enumerate(steps):
            show("measuring", done, len(steps) + 1)
            figures[name] = rates(run_together(prepare, arguments, processes))
        show("measuring", len(steps), len(steps) + 1)
        ((_, build),) = run_each(partial(_build_large_city, renderer), [LARGE_CITY_M], 1)
        show("measuring", len(steps) + 1, len(steps) + 1)
    return {
        "processes": processes,
        "renderer": renderer,
        "size_px": [WIDTH_PX, HEIGHT_PX],
        "rendered": {name: figures[f"render {name}"] for name in SCENES},
        "degraded": {"sharp": figures["degrade"], "blurred": figures["degrade and blur"]},
        "build": build,
        "asked": TARGETS,
    }


def run_together(prepare: Callable[..., Work], arguments: tuple[Any, ...], processes: int) -> list[Lap]:
    """Measure the same work in several new processes that start it at the same moment.

    Args:
        prepare: called in each process with its index and the arguments; returns the work. A function of a
            module, since it is sent by name.
        arguments: for ``prepare``.
        processes: number of processes.
    """
    # A barrier can be sent to a process only as it starts: with the task.
    barrier = get_context("spawn").Barrier(processes, timeout=_SET_UP_TIMEOUT_S)
    task = partial(_lap, barrier, prepare, arguments)
    with open_pool(task, PoolSettings(processes, single_threaded=False)) as pool:
        ended = list(pool.run(deque(range(processes))))
    # A process that found the barrier broken is not the one at fault.
    ended.sort(key=lambda end: (isinstance(end.error, BrokenBarrierError), end.item))
    return [end.result() for end in ended]


def rates(laps: list[Lap]) -> dict[str, float]:
    """Figures of processes that ran at once.

    Returns:
        ``frames_per_s`` of all together in elapsed time, until the last ends; ``cpu_ms`` per frame;
        ``frames_per_s_alone``, the rate if each had its own core; ``peak_rss_mb``, the largest.
    """
    frames = sum(lap.frames for lap in laps)
    cpu_ms = 1e3 * sum(lap.cpu_s for lap in laps) / frames
    return {
        "frames": frames,
        "frames_per_s": frames / max(lap.wall_s for lap in laps),
        "cpu_ms": cpu_ms,
        "frames_per_s_alone": 1e3 * len(laps) / cpu_ms,
        "peak_rss_mb": max(lap.peak_rss_mb for lap in laps),
    }


def _lap(barrier: Barrier, prepare: Callable[..., Work], arguments: tuple[Any, ...], index: int) -> Lap:
    try:
        work = prepare(index, *arguments)
    except BaseException:
        barrier.abort()  # the others would wait forever
        raise
    barrier.wait()
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    frames = work()
    return Lap(frames, time.perf_counter() - wall_s, time.process_time() - cpu_s, peak_rss_mb())


def _prepare_render(
    index: int, name: str, length_m: float | None, processes: int, frames: int, renderer_name: str
) -> Work:
    """Prepare to render clean frames along a scenario's path, each process on its own part."""
    from dslab.scenarios.loading import load_scenario
    from dslab.sim.frame_plan import plan_frames, render_backend

    scenario, backend = load_scenario(name), render_backend(renderer_name)
    if length_m is not None:
        scenario = scenario.model_copy(
            update={"world": scenario.world.model_copy(update={"length_m": length_m})}
        )
    plan, world = plan_frames(scenario, backend)
    renderer = backend.renderer(world, _intrinsics())
    poses = plan.motion.T_world_cam(plan.stamps_s)
    start = index * len(poses) // processes
    renderer.render(poses[start])

    def render() -> int:
        for frame in range(frames):
            renderer.render(poses[(start + frame) % len(poses)])
        return frames

    return render


def _prepare_degrade(index: int, frames: int, exposure_s: float, cache: Path, renderer: str) -> Work:
    """Prepare to degrade cached frames of a corridor: fog, defocus, low light and sensor noise."""
    from dslab.sim.sequence_rendering import render_backend, render_sequence

    backend = render_backend(renderer)
    # Each process has its own frames in the cache, and a severity that is not yet there.
    cache_dir, seconds = cache / str(index), max(1.0, frames / 30)
    first, second = (_degraded(seconds, exposure_s, light) for light in (0.2, 0.1))
    render_sequence(first, index, cache_dir=cache_dir, backend=backend)
    return lambda: len(render_sequence(second, index, cache_dir=cache_dir, backend=backend))


def _degraded(seconds: float, exposure_s: float, illumination: float):
    from dslab.scenarios.spec import Scenario

    camera = {"width_px": WIDTH_PX, "height_px": HEIGHT_PX, "fx_px": FOCAL_PX, "fy_px": FOCAL_PX}
    severities = {
        "fog": {"extinction_per_m": 0.1},
        "defocus": {"diameter_px": 4.0},
        "low_light": {"illumination": illumination},
    }
    whole = {"start_s": 0.0, "duration_s": seconds}
    return Scenario.model_validate(
        {
            "name": "bench",
            "duration_s": seconds,
            "world": {"kind": "corridor", "length_m": 20},
            "trajectory": {"max_speed_mps": 1.5, "max_rate_degps": 60},
            "camera": {**camera, "fps": 30, "exposure_s": exposure_s},
            "segments": [{"kind": kind, **whole, **severity} for kind, severity in severities.items()],
        }
    )


def _build_large_city(renderer: str, length_m: float) -> dict[str, float]:
    """Measure building a city and loading it into a renderer."""
    from dslab.scenarios.worlds import CityWorld
    from dslab.sim.frame_plan import render_backend

    backend = render_backend(renderer)
    backend.build_world(CityWorld(length_m=100, turns=0), 0)  # compiles the kernels
    started_s, started_cpu_s = time.perf_counter(), time.process_time()
    world = backend.build_world(CityWorld(length_m=length_m), 0)
    built_s, built_cpu_s = time.perf_counter(), time.process_time()
    backend.renderer(world, _intrinsics())
    return {
        "build_s": built_s - started_s,
        "build_cpu_s": built_cpu_s - started_cpu_s,
        "load_s": time.perf_counter() - built_s,
        "load_cpu_s": time.process_time() - built_cpu_s,
        "surfaces": len(world.surfaces),
        "peak_rss_mb": peak_rss_mb(),
    }


def _intrinsics():
    from dslab.sim.sensors.camera import Intrinsics

    centre = ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    return Intrinsics(WIDTH_PX, HEIGHT_PX, FOCAL_PX, FOCAL_PX, *centre, 30.0)
