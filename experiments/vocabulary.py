"""Training of the vocabulary for place recognition, only on frames rendered by this project."""

from collections.abc import Iterable

import numpy as np

from dslab.experiments.runs.execution import slam_camera
from dslab.scenarios.spec import Scenario
from dslab.sim.io.folders import Progress
from dslab.sim.sequence import Sequence
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.config import default_config
from dslab.slam.features.orb import OrbExtractor
from dslab.slam.places.recognition import Vocabulary
from dslab.slam.places.training import train_vocabulary

BRANCHING, LEVELS, SEEDS_EACH = 10, 4, 3
FIRST_SEED = 1000
"""First seed for training; experiments and tests use lower seeds."""
_DURATION_S = 36


def training_scenarios() -> list[Scenario]:
    """Scenarios of every world, with several carriers and cameras, at one frame per second."""
    indoor = {"fx_px": 500, "fy_px": 500, "fps": 1}
    wide = {"fx_px": 420, "fy_px": 420, "fps": 1}
    shoots = [
        ("room", {}, {"kind": "walk"}, indoor),
        ("room", {"length_m": 8, "width_m": 6}, {"kind": "handheld"}, {"preset": "realsense", "fps": 1}),
        ("corridor", {}, {"kind": "walk"}, wide),
        ("corridor", {"turns": 3}, {"kind": "handheld", "gaze_deg": 90}, indoor),
        ("city", {}, {"kind": "car"}, {"preset": "kitti", "fps": 1}),
        ("city", {"loop": True}, {"kind": "car", "gaze_deg": 30}, {"preset": "euroc", "fps": 1}),
        ("motorway", {}, {"kind": "car"}, {"preset": "kitti", "fps": 1}),
        ("field", {}, {"kind": "handheld"}, wide),
        ("field", {}, {"kind": "drone"}, {"preset": "euroc", "fps": 1}),
        ("warehouse", {}, {"kind": "drone"}, indoor),
        ("warehouse", {}, {"kind": "handheld"}, wide),
    ]
    return [
        Scenario(
            name=f"vocabulary/{kind}-{number}",
            duration_s=_DURATION_S,
            world={"kind": kind, **world},
            trajectory=trajectory,
            camera=camera,
        )
        for number, (kind, world, trajectory, camera) in enumerate(shoots)
    ]


def describe(sequence: Sequence) -> list[np.ndarray]:
    """(n, 4) uint64 ORB descriptors of every frame of a sequence, as extracted by the SLAM."""
    camera = slam_camera(sequence.camera)
    extractor = OrbExtractor(camera.width_px, camera.height_px, default_config(camera).orb)
    frames = (extractor.extract(sequence.frames[i]) for i in range(len(sequence)))
    return [features.descriptors for features in frames if len(features)]


def train(
    scenarios: Iterable[Scenario] | None = None,
    seeds_each: int = SEEDS_EACH,
    branching: int = BRANCHING,
    levels: int = LEVELS,
    progress: Progress | None = None,
) -> Vocabulary:
    """Render a training set and train a vocabulary on it.

    Args:
        scenarios: the training set; None for that of the package.
        seeds_each: number of seeds of each scenario, from ``FIRST_SEED`` on.
        branching, levels: of the tree.
        progress: called with (step, done, total).

    Raises:
        InputError: the frames cannot be rendered.
    """
    scenarios = training_scenarios() if scenarios is None else list(scenarios)
    jobs = [(scenario, FIRST_SEED + n) for scenario in scenarios for n in range(seeds_each)]
    images: list[np.ndarray] = []
    for done, (scenario, world_seed) in enumerate(jobs, 1):
        with scratch_folder() as folder:
            images += describe(render_sequence(scenario, world_seed, cache_dir=folder))
        if progress is not None:
            progress("training images", done, len(jobs))
    provenance = {
        "images": "rendered by this project",
        "scenarios": [s.model_dump(mode="json") for s in scenarios],
        "seeds": [FIRST_SEED, FIRST_SEED + seeds_each - 1],
        "frames": len(images),
        "descriptors": sum(len(d) for d in images),
        "branching": branching,
        "levels": levels,
        "seed": 0,
    }
    return train_vocabulary(images, branching, levels, 0, provenance)
