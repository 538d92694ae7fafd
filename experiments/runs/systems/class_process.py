"""A class of one's own in a process of its own, in which it may crash, hang or fill the memory.

    python -m dslab.experiments.runs.systems.class_process FOLDER SOURCE SEED

runs the class of a source over the frames in a folder, and writes what it says there, frame by frame:
whatever ends the process, what it had said until then stays known.
"""

import pickle
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dslab.experiments.runs.ending import Declares, Ending, EndKind
from dslab.experiments.runs.execution import RunRecord, live_trajectories, slam_camera
from dslab.experiments.runs.systems.command_spec import Limits
from dslab.experiments.runs.systems.guarded import GuardedRun, run_guarded
from dslab.experiments.runs.systems.own_class import ClassSystem, class_system
from dslab.experiments.runs.systems.poses_only import PosesOnly, frame_result
from dslab.sim.sequence import Sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.core.events import Event
from dslab.slam.core.results import MapTrajectory, TrackingResult

_FRAMES, _ABOUT, _SAID, _LOG = "frames.npy", "about.pickle", "said.pickle", "log.txt"


@dataclass(frozen=True)
class _Step:
    """What the class has said of one frame: its result, and the events since the one before."""

    result: TrackingResult
    events: tuple[Event, ...]
    declares: Declares


@dataclass(frozen=True)
class _End:
    """What it has said in the end."""

    trajectories: tuple[MapTrajectory, ...]
    events: tuple[Event, ...]
    declares: Declares
    ending: Ending


def run_class_apart(system: ClassSystem, sequence: Sequence, seed: int, limits: Limits) -> RunRecord:
    """Run a class over a sequence in a process of its own. How it ends is in the record, whatever it does.

    Args:
        system: the class, found there by its source.
        sequence: the frames; the truth is not passed on.
        seed: given to the class.
        limits: of time and memory.
    """
    duration_s = float(sequence.stamps_s[-1] - sequence.stamps_s[0])
    with scratch_folder() as folder:
        _write_frames(folder, sequence)
        # Without the present folder before all others on the path: a file there may have any name.
        words = [sys.executable, "-P", "-m", __name__, str(folder), system.source, str(seed)]
        time_s = limits.start_s + limits.slow_down * duration_s
        run = run_guarded(words, folder / _LOG, time_s, limits.memory_mb, Path.cwd())
        said = list(_said(folder / _SAID))
    return _record(system, sequence, seed, run, said)


def _record(
    system: ClassSystem, sequence: Sequence, seed: int, run: GuardedRun, said: list[_Step | _End]
) -> RunRecord:
    steps = [step for step in said if isinstance(step, _Step)]
    end = next((e for e in said if isinstance(e, _End)), None)
    results = [step.result for step in steps]
    was_initialized = any(result.T_map_cam is not None for result in results)
    results += [
        frame_result(frame, float(sequence.stamps_s[frame]), None, was_initialized)
        for frame in range(len(steps), len(sequence))
    ]
    live = live_trajectories(results)
    if end is None:
        declares = steps[-1].declares if steps else Declares.NOTHING
        events = tuple(event for step in steps for event in step.events)
        end = _End(tuple(live.values()), events, declares, _cut_short(run.ending))
    return RunRecord(
        sequence=sequence,
        system_kind=system.name,
        seed=seed,
        config={"system": system.source},
        results=tuple(results),
        events=end.events,
        trajectories=end.trajectories,
        keyframes=(),
        live=live,
        map_points={},
        wall_s=run.wall_s,
        peak_rss_mb=run.peak_rss_mb,
        ending=end.ending,
        declares=end.declares,
    )


def _cut_short(ending: Ending) -> Ending:
    """The end of a process that has not come to its own."""
    if ending.kind is not EndKind.FINISHED:
        return ending
    return Ending(EndKind.CRASHED, "its process ended before the last frame", "do not end the process")


def _write_frames(folder: Path, sequence: Sequence) -> None:
    shape = (len(sequence), sequence.camera.height_px, sequence.camera.width_px)
    frames = np.lib.format.open_memmap(folder / _FRAMES, "w+", np.uint8, shape)
    for index in range(len(sequence)):
        frames[index] = sequence.frames[index]
    frames.flush()
    about = {"camera": slam_camera(sequence.camera), "stamps_s": sequence.stamps_s}
    (folder / _ABOUT).write_bytes(pickle.dumps(about))


def _said(path: Path) -> Iterator[_Step | _End]:
    """What was said, as far as it was written."""
    if not path.exists():
        return
    with path.open("rb") as file:
        while True:
            try:
                said = pickle.load(file)
            except Exception:  # the process was ended while it wrote, or it is of no kind known here
                return
            yield said


def _run(folder: Path, source: str, seed: int) -> None:
    """Run the class of a source in this process."""
    import cv2

    from dslab.experiments.plugins import load_plugins

    cv2.setNumThreads(1)
    load_plugins()
    system = class_system(source)
    about = pickle.loads((folder / _ABOUT).read_bytes())
    frames = np.load(folder / _FRAMES, mmap_mode="r")
    made: PosesOnly = system.build(about["camera"], seed)
    told = 0
    with (folder / _SAID).open("wb") as file:
        for image, stamp_s in zip(frames, about["stamps_s"], strict=True):
            result = made.process(np.array(image), float(stamp_s))
            events = made.events
            file.write(pickle.dumps(_Step(result, tuple(events[told:]), made.declares)))
            file.flush()
            told = len(events)
        made.finish()
        end = _End(tuple(made.trajectories()), tuple(made.events), made.declares, made.ending)
        file.write(pickle.dumps(end))


if __name__ == "__main__":
    # Under its own name, so that what is pickled here is known there.
    from dslab.experiments.runs.systems.class_process import _run as run

    run(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
