"""A run of a program over a sequence: it is given frames without truth, and its files become a record."""

import json
import shlex
import shutil
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.runs.ending import Declares, Ending, EndKind
from dslab.experiments.runs.execution import Observer, RunRecord, live_trajectories
from dslab.experiments.runs.systems.command_spec import CommandSpec, filled
from dslab.experiments.runs.systems.environments import python_of
from dslab.experiments.runs.systems.guarded import GuardedRun, run_guarded
from dslab.experiments.runs.systems.left_files import LeftFrames, read_frames, read_poses
from dslab.experiments.runs.systems.poses_only import PosesOnly, frame_result
from dslab.experiments.runs.systems.vocabulary_text import vocabulary_of
from dslab.scenarios.errors import InputError
from dslab.sim.io.forms import Form, write_sequence
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage, Event
from dslab.slam.core.results import MapTrajectory, TrackingResult

LOG_FILE = "log.txt"
SETTINGS_FILE = "settings.json"


@dataclass(frozen=True)
class CommandSystem:
    """A program that a YAML file describes.

    Attributes:
        name: of the system.
        spec: the description.
        file: where it stands.
    """

    name: str
    spec: CommandSpec
    file: Path

    @property
    def takes_real_time(self) -> bool:
        """True if it takes frames in real time: what runs beside it changes what it does."""
        return self.spec.pace == "real_time"

    def check(self) -> list[str]:
        """Check that it could be started; returns the words of its command, with placeholders.

        Raises:
            InputError: the command is no command line, there is no such program, or its environment is not
                installed.
        """
        where = f"{self.file}: command"
        try:
            words = shlex.split(self.spec.command)
        except ValueError as error:
            raise InputError(where, f"is no command line ({error})", "check its quotes") from None
        program = filled(words[:1], self._fixed())[0]
        if shutil.which(program) is None:
            raise InputError(where, f"no such command: {program}", "check its path, or install it")
        return words

    def _fixed(self) -> dict[str, Any]:
        """Values of the placeholders that are the same in every run.

        Raises:
            InputError: its environment is not installed.
        """
        return {"python": python_of(self.name, self.spec.environment), "here": self.file.parent.resolve()}


@contextmanager
def sequence_folder_of(sequence: Sequence, reads: str, scratch: Path):
    """Yield a folder of the frames and the camera, without truth and without what was injected."""
    folder = scratch / f"sequence-{reads}"
    if not folder.exists():
        blind = replace(
            sequence, T_world_cam=None, depths=None, segments=(), meta={}, frame_truth={}, image_names=()
        )
        write_sequence(blind, folder, Form(reads))
    yield folder


def run_command(
    system: CommandSystem,
    sequence: Sequence,
    seed: int,
    folder: Path,
    scratch: Path,
    observer: Observer | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RunRecord:
    """Run a program over a sequence. How it ends is in the record, whatever it does.

    Args:
        system: the program.
        sequence: the frames; the truth is not passed on.
        seed: given to the command where it asks for one.
        folder: existing folder for what it prints and its settings.
        scratch: existing folder for the frames, which further runs over the same sequence find again, and for
            what the program leaves.
        observer: called after the end for every frame.
        progress: called with (frames done, frames in all).

    Raises:
        InputError: the program cannot be started, or its form cannot hold the sequence.
    """
    words, spec = system.check(), system.spec
    left = scratch / f"left-{system.name}"
    shutil.rmtree(left, ignore_errors=True)
    left.mkdir()
    settings = dict(spec.settings)
    values = {**system._fixed(), "seed": seed, "out": left, "settings": folder / SETTINGS_FILE}
    if any("{vocabulary}" in word for word in words):
        values["vocabulary"], settings["vocabulary"] = vocabulary_of(settings.get("vocabulary"))
    (folder / SETTINGS_FILE).write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
    duration_s = float(sequence.stamps_s[-1] - sequence.stamps_s[0]) if len(sequence) else 0.0
    time_s = spec.limits.start_s + spec.limits.slow_down * duration_s
    with sequence_folder_of(sequence, spec.reads, scratch) as frames_dir:
        values["sequence"] = frames_dir
        command = filled(words, values)
        run = run_guarded(command, folder / LOG_FILE, time_s, spec.limits.memory_mb, left)
    config = {"system": system.name, "about": spec.about, "command": spec.command, "settings": settings}
    record = _record(system, sequence, seed, left, run, config)
    _show(record, observer, progress)
    return record


def _record(
    system: CommandSystem, sequence: Sequence, seed: int, left: Path, run: GuardedRun, config: dict
) -> RunRecord:
    spec, form = system.spec, system.spec.trajectory_form
    final = read_poses(left / spec.trajectory, form, sequence)
    live = None if spec.live is None else read_poses(left / spec.live, form, sequence)
    keyframes = None if spec.keyframes is None else read_poses(left / spec.keyframes, form, sequence)
    frames = LeftFrames() if spec.frames is None else read_frames(left / spec.frames, sequence)
    given = final if live is None else live
    made = [k.frames for k in (keyframes and keyframes.trajectory,) if k is not None]
    results = _results(sequence, given.trajectory, frames, np.concatenate(made) if made else np.empty(0, int))
    faults = [of.fault for of in (final, live, keyframes, frames) if of is not None]
    return RunRecord(
        sequence=sequence,
        system_kind=system.name,
        seed=seed,
        config=config,
        results=results,
        events=_losses(sequence, frames, spec.lost_states),
        trajectories=_some(final.trajectory),
        keyframes=_some(keyframes.trajectory if keyframes else None),
        live=live_trajectories(results),
        map_points={},
        wall_s=run.wall_s,
        peak_rss_mb=run.peak_rss_mb,
        ending=_worst(run.ending, faults),
        declares=Declares.LOSSES if spec.lost_states else Declares.NOTHING,
        has_live_poses=live is not None,
    )


def _some(trajectory: MapTrajectory | None) -> tuple[MapTrajectory, ...]:
    return () if trajectory is None else (trajectory,)


def _worst(ending: Ending, faults: list[Ending]) -> Ending:
    """How it ended; if well, the first fault of its files."""
    return next((e for e in (ending, *faults) if e.kind is not EndKind.FINISHED), ending)


def _results(
    sequence: Sequence, given: MapTrajectory | None, frames: LeftFrames, keyframes: np.ndarray
) -> tuple[TrackingResult, ...]:
    poses = {} if given is None else dict(zip(given.frames.tolist(), given.T_map_cam, strict=True))
    first = min(poses, default=len(sequence))
    made = set(keyframes.tolist())
    return tuple(
        frame_result(
            frame,
            float(stamp_s),
            poses.get(frame),
            frame > first,
            reason="" if frame in poses else frames.states.get(frame, ""),
            ms={"process": frames.ms[frame]} if frame in frames.ms else {},
            cpu_ms={"process": frames.cpu_ms[frame]} if frame in frames.cpu_ms else {},
            is_keyframe=frame in made,
        )
        for frame, stamp_s in enumerate(sequence.stamps_s)
    )


def _losses(sequence: Sequence, frames: LeftFrames, words: tuple[str, ...]) -> tuple[Event, ...]:
    """A breakage where the state becomes one of some words, from one that is none of them."""
    found, was_lost = [], False
    for frame in sorted(frames.states):
        is_lost = frames.states[frame] in words
        if is_lost and not was_lost:
            stamp_s = float(sequence.stamps_s[frame])
            reason = frames.states[frame].lower()
            found.append(Breakage(frame=frame, stamp_s=stamp_s, map_id=0, reason=reason, inliers=0))
        was_lost = is_lost
    return tuple(found)


def _show(record: RunRecord, observer: Observer | None, progress: Callable[[int, int], None] | None) -> None:
    frames = len(record.results)
    if observer is not None:
        shown = PosesOnly(_Nothing(), None, record.system_kind)  # type: ignore[arg-type]
        for result in record.results:
            observer.frame(record.sequence.frames[result.frame], result, shown)
    if progress is not None:
        progress(frames, frames)


class _Nothing:
    def process(self, image: np.ndarray, stamp_s: float) -> None:
        return None
