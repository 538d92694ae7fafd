"""A run of a program over a sequence: it is given frames without truth, and its files become a record."""

import json
import shlex
import shutil
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.runs.ending import Declares, Ending, EndKind
from dslab.experiments.runs.execution import Observer, RunRecord, live_trajectories, tell_unread
from dslab.experiments.runs.systems.command_spec import CommandSpec, filled
from dslab.experiments.runs.systems.environments import python_of
from dslab.experiments.runs.systems.guarded import GuardedRun, run_guarded
from dslab.experiments.runs.systems.left_events import read_events
from dslab.experiments.runs.systems.left_files import read_frames, read_maps
from dslab.experiments.runs.systems.poses_only import PosesOnly, frame_result
from dslab.experiments.runs.systems.vocabulary_text import vocabulary_of
from dslab.scenarios.errors import InputError
from dslab.sim.io.forms import Form, write_sequence
from dslab.sim.sequence import Sequence
from dslab.sim.unfinished import scratch_folder
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


def write_blind(sequence: Sequence, reads: str, folder: Path) -> None:
    """Write a folder of the frames and the camera, without truth and without what was injected."""
    blind = replace(
        sequence, T_world_cam=None, depths=None, segments=(), meta={}, frame_truth={}, image_names=()
    )
    write_sequence(blind, folder, Form(reads), colour=False)


def _write_readable(sequence: Sequence, reads: str, folder: Path) -> tuple[Sequence, int]:
    """As ``write_blind``; returns the sequence without frames that cannot be read, and their number."""
    try:
        write_blind(sequence, reads, folder)
        return sequence, 0
    except InputError:
        faults: dict[int, InputError] = {}
        for index in range(len(sequence)):
            try:
                sequence.frames[index]
            except InputError as fault:
                faults[index] = fault
        if not faults:
            raise
    left = sequence.only(np.setdiff1d(np.arange(len(sequence)), list(faults)))
    tell_unread(list(faults.values()), len(left))
    write_blind(left, reads, folder)
    return left, len(faults)


def run_command(
    system: CommandSystem,
    sequence: Sequence,
    seed: int,
    folder: Path | None = None,
    observer: Observer | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RunRecord:
    """Run a program over a sequence. How it ends is in the record, whatever it does.

    It is given a copy of the frames of its own: what it does to them reaches nothing and no other run.

    Args:
        system: the program.
        sequence: the frames; the truth is not passed on.
        seed: given to the command where it asks for one.
        folder: existing folder for what it prints and its settings; None for none that stays.
        observer: called after the end for every frame.
        progress: called with (frames done, frames in all).

    Raises:
        InputError: the program cannot be started, its form cannot hold the sequence, or no frame can be read.
    """
    words, spec = system.check(), system.spec
    settings, values = dict(spec.settings), {**system._fixed(), "seed": seed}
    if any("{vocabulary}" in word for word in words):
        values["vocabulary"], settings["vocabulary"] = vocabulary_of(settings.get("vocabulary"))
    duration_s = float(sequence.stamps_s[-1] - sequence.stamps_s[0]) if len(sequence) else 0.0
    time_s = spec.limits.start_s + spec.limits.slow_down * duration_s
    config = {"system": system.name, "about": spec.about, "command": spec.command, "settings": settings}
    with scratch_folder() as scratch:
        frames, left, kept = scratch / "sequence", scratch / "left", folder or scratch
        left.mkdir()
        sequence, unread = _write_readable(sequence, spec.reads, frames)
        (kept / SETTINGS_FILE).write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
        values |= {"sequence": frames, "out": left, "settings": kept / SETTINGS_FILE}
        run = run_guarded(filled(words, values), kept / LOG_FILE, time_s, spec.limits.memory_mb, left)
        record = replace(_record(system, sequence, seed, left, run, config), unreadable_frames=unread)
    _show(record, observer, progress)
    return record


def _record(
    system: CommandSystem, sequence: Sequence, seed: int, left: Path, run: GuardedRun, config: dict
) -> RunRecord:
    spec = system.spec
    faults: list[Ending] = []

    def poses(name: str | None) -> tuple[MapTrajectory, ...]:
        return () if name is None else read_maps(left, name, spec.trajectory_form, sequence, faults)

    paths, live, made = poses(spec.trajectory), poses(spec.live), poses(spec.keyframes)
    frames = {} if spec.frames is None else read_frames(left / spec.frames, sequence, faults)
    events = () if spec.events is None else read_events(left / spec.events, sequence.stamps_s, faults)
    places = {path.map_id: place for place, path in enumerate(paths)}
    made = sorted(made, key=lambda path: places.get(path.map_id, len(places)))
    events = events if spec.events else _losses(sequence, frames, spec.lost_states)
    results = _results(sequence, paths[:1] if spec.live is None else live, frames, made)
    if not any("map_id" in said for said in frames.values()):
        results = _in_maps(results, [event.frame for event in events if isinstance(event, Breakage)], paths)
    ending = next((e for e in (run.ending, *faults) if e.kind is not EndKind.FINISHED), run.ending)
    declares = Declares.LOSSES if spec.lost_states else Declares.NOTHING
    return RunRecord(
        sequence=sequence,
        system_kind=system.name,
        seed=seed,
        config=config,
        results=results,
        events=events,
        trajectories=paths,
        keyframes=tuple(made),
        live=live_trajectories(results),
        map_points={},
        wall_s=run.wall_s,
        peak_rss_mb=run.peak_rss_mb,
        ending=ending,
        declares=Declares.EVENTS if spec.events else declares,
        has_live_poses=spec.live is not None,
        cpu_s=run.cpu_s,
    )


def _results(
    sequence: Sequence,
    given: Many[MapTrajectory],
    frames: Mapping[int, Mapping[str, Any]],
    keyframes: Many[MapTrajectory],
) -> tuple[TrackingResult, ...]:
    poses = {int(f): T for path in given for f, T in zip(path.frames, path.T_map_cam, strict=True)}
    first = min(poses, default=len(sequence))
    made = {int(f) for path in keyframes for f in path.frames}
    results = []
    for frame, stamp_s in enumerate(sequence.stamps_s):
        said = frames.get(frame, {})
        result = frame_result(
            frame,
            float(stamp_s),
            poses.get(frame),
            frame > first,
            reason="" if frame in poses else said.get("state", ""),
            ms={"process": said["ms"]} if "ms" in said else {},
            cpu_ms={"process": said["cpu_ms"]} if "cpu_ms" in said else {},
            is_keyframe=frame in made,
        )
        beside = {name: said.get(name, 0.0) for name in ("mapping_cpu_ms", "loop_cpu_ms")}
        results.append(replace(result, map_id=int(said.get("map_id", 0)), **beside))
    return tuple(results)


def _in_maps(
    results: tuple[TrackingResult, ...], losses: Many[int], final: Many[MapTrajectory]
) -> tuple[TrackingResult, ...]:
    """Outcomes with the map of their poses, of a program that does not say it.

    Poses behind a loss are of another map, unless the final ones of a former map have some of their frames.
    """
    if not final:
        return results
    part_of = np.searchsorted(losses, [result.frame for result in results], side="right")
    posed = np.array([result.T_map_cam is not None for result in results])
    map_of: dict[int, int] = {}  # of final trajectories
    ids = np.zeros(len(results), int)
    for part in range(len(losses) + 1):
        frames = np.flatnonzero(posed & (part_of == part))
        shares = [float(np.isin(frames, path.frames).mean()) if len(frames) else 0.0 for path in final]
        best = int(np.argmax(shares))
        ids[part_of == part] = map_of.setdefault(best, part) if shares[best] else part
    return tuple(replace(result, map_id=int(k)) for result, k in zip(results, ids, strict=True))


def _losses(
    sequence: Sequence, frames: Mapping[int, Mapping[str, Any]], words: tuple[str, ...]
) -> tuple[Event, ...]:
    """A breakage where the state becomes one of some words, from one that is none of them."""
    found, was_lost = [], False
    for frame in sorted(frames):
        is_lost = frames[frame]["state"] in words
        if is_lost and not was_lost:
            stamp_s, reason = float(sequence.stamps_s[frame]), frames[frame]["state"].lower()
            found.append(Breakage(frame=frame, stamp_s=stamp_s, map_id=0, reason=reason, inliers=0))
        was_lost = is_lost
    return tuple(found)


def _show(record: RunRecord, observer: Observer | None, progress: Callable[[int, int], None] | None) -> None:
    frames = len(record.results)
    if observer is not None:
        shown = PosesOnly(None, None, record.system_kind)
        for result in record.results:
            observer.frame(record.sequence.frames[result.frame], result, shown)
    if progress is not None:
        progress(frames, frames)
