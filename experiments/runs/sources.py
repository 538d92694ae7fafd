"""Open a sequence by a user's name for it: a folder, a scenario, or a scenario file."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder, is_given
from dslab.sim.io.bag import is_bag
from dslab.sim.io.folders import Progress
from dslab.sim.io.video import is_video
from dslab.sim.room import check_room, images_need
from dslab.sim.sensors.imu import ImuReadings, ImuTruth
from dslab.sim.sequence import Sequence, is_coloured

if TYPE_CHECKING:
    from dslab.sim.io.forms import TruthForm


def is_recorded(source: str) -> bool:
    """True for a folder or a ROS bag: it has frames of its own, and needs no camera beside it."""
    return is_folder(source) or is_bag(source)


def open_sequence(
    source: str,
    seed: int | None = None,
    progress: Progress | None = None,
    depth: bool = False,
    renderer: str | None = None,
    out_dir: Path | None = None,
    force: bool = False,
    camera: Path | None = None,
    first_s: float | None = None,
    cache_dir: Path | None = None,
    truth: Path | None = None,
    truth_form: "TruthForm" = "tum",
) -> Sequence:
    """Load a sequence folder, a bag, images or a video, or render a scenario or read it from the cache.

    Args:
        source: a folder of a form of ``sim.io.forms``, a ROS bag, the name of a scenario, or the path of its
            YAML file; with a camera a folder of images or a video file.
        seed: root seed of a scenario, with which it is also drawn; None for its own; unused for a folder.
        progress: called with (step, frames done, frames in all) while rendering.
        depth: render a scenario with depth images; no effect on a folder.
        renderer: renderer of a scenario, one of ``sim.rendering.renderers``; None for the default one.
        out_dir: where the caller will write the images, so that there is room; None for nowhere.
        force: begin even if disks and memory seem too small, or the frames are very many.
        camera: camera.yaml of images or a video; None for a source that has its own.
        first_s: only the frames of the first seconds, of a scenario these alone are rendered; None for all.
        cache_dir: folder of the cache of rendered frames; None for the default one.
        truth, truth_form: true poses of a folder, images or a video, as of ``sim.load_sequence``.

    Raises:
        InputError: the source does not exist or is not valid, a renderer is named for a folder, or there is
            no room for the frames.
    """
    path = Path(source)
    if is_recorded(source) or is_video(path) or camera is not None:
        if renderer is not None:
            problem = "the frames are already there"
            raise InputError(f"--renderer: {source}", problem, "name a scenario, or leave out --renderer")
        from dslab.sim.io.forms import load_sequence

        sequence = load_sequence(path, camera, progress, force, truth, truth_form)
        if out_dir is not None:
            size_px = sequence.camera.width_px, sequence.camera.height_px
            with_depth, colour = sequence.depths is not None, is_coloured(sequence.frames)
            needs = [images_need(out_dir, len(sequence), size_px, with_depth, colour)]
            check_room(str(path), len(sequence), needs, force)
        sequence = replace(sequence, source=source)
        return sequence if first_s is None else sequence.first(first_s)
    if truth is not None:
        raise InputError(f"--truth: {truth}", "a scenario has its own truth", "leave it out")
    from dslab.scenarios.families import is_scenario_name
    from dslab.scenarios.loading import load_scenario

    if not is_given(path) and len(path.parts) > 1 and not is_scenario_name(source):
        raise InputError(
            source, "no such folder", "check the path, or name a scenario (dslab scenarios list)"
        )
    from dslab.sim.sequence_rendering import images_need_of, render_backend, render_sequence

    backend = render_backend(renderer) if renderer is not None else None
    scenario = load_scenario(source, seed)
    needs = [] if out_dir is None else [images_need_of(scenario, out_dir, depth)]
    rendered = render_sequence(
        scenario, cache_dir=cache_dir, depth=depth, first_s=first_s, progress=progress, backend=backend,
        needs=needs, force=force,
    )  # fmt: skip
    return replace(rendered, source=source)


def open_imu(
    source: str, stamps_s: np.ndarray, seed: int | None = None, wanted: bool | None = None
) -> tuple[ImuReadings, ImuTruth | None] | None:
    """Open the inertial readings of a folder, or make those along a scenario's motion.

    Args:
        source: as for ``open_sequence``.
        stamps_s: (N,) stamps of its frames.
        seed: root seed of a scenario; None for its own.
        wanted: False for none; True for EuRoC's sensor if a scenario names none; None for the source's.

    Returns:
        The readings and, for a scenario, the truth at its frames; None without readings.

    Raises:
        InputError: a folder has no readings although wanted, or the source is not valid.
    """
    if wanted is False:
        return None
    if is_recorded(source):
        readings = _folder_imu(Path(source)) if is_folder(source) else None
        if wanted and readings is None:
            problem = "the folder has no inertial readings, and no continuous motion to make them from"
            raise InputError(f"--imu: {source}", problem, "name a scenario, or leave out --imu")
        return None if readings is None else (readings, None)
    from dslab.scenarios.loading import load_scenario
    from dslab.sim.frame_plan import plan_path, render_backend
    from dslab.sim.sensors.imu import ImuModel, record_imu

    scenario = load_scenario(source, seed)
    if scenario.imu is None and not wanted:
        return None
    model = ImuModel.of_spec(scenario.imu) if scenario.imu else None
    return record_imu(plan_path(scenario, render_backend()), stamps_s, scenario.seed, model)


def _folder_imu(folder: Path) -> ImuReadings | None:
    from dslab.sim.io.euroc import load_euroc_imu
    from dslab.sim.io.forms import Form, detect_form, sequence_folder

    folder = sequence_folder(folder)
    return load_euroc_imu(folder) if detect_form(folder) is Form.EUROC else None
