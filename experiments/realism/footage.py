"""One sequence through the base, and what that met on its way."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.realism.images import frame_statistics
from dslab.experiments.realism.live import live_residuals
from dslab.experiments.realism.measures import MEASURES
from dslab.experiments.realism.tracked import map_statistics
from dslab.experiments.runs.execution import RunRecord, SlamSystem, execute
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import CameraRefined, TrackingState
from dslab.slam.core.results import TrackingResult
from dslab.slam.system import MonocularSlam

_LOOKED_AT_EVERY = 10  # frames, for the statistics of images
_MATCHED_EVERY = 5  # frames, for the residuals of all matches
_REMOVED_FROM = 2.45  # sigma: from here the tracker removes a match


@dataclass(frozen=True)
class Footage:
    """What one sequence is like.

    Attributes:
        name: of the sequence.
        values: (n,) float64 samples of each measure, by its name.
        figures: single figures; None where there is no truth, or nothing was tracked.
        scale_along: relative scale of each tenth of the path, None without a step; empty without truth.
    """

    name: str
    values: dict[str, np.ndarray]
    figures: dict[str, float | int | None]
    scale_along: tuple[float | None, ...] = ()


@dataclass
class _Looking:
    """Observer that measures frames at intervals: every so many images, and matches between keyframes."""

    found: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def frame(self, image: np.ndarray, result: TrackingResult, system: SlamSystem) -> None:
        if result.frame % _LOOKED_AT_EVERY == 0:
            for name, values in frame_statistics(image).items():
                self.found.setdefault(name, []).append(values)
        tracked = result.state is TrackingState.TRACKING and not result.is_keyframe
        if tracked and result.frame % _MATCHED_EVERY == 0 and isinstance(system, MonocularSlam):
            self.found.setdefault("live_residual", []).append(live_residuals(system))


def measure_footage(
    sequence: Sequence, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> Footage:
    """Run the base in lockstep and collect every measure, of the map with most frames.

    Args:
        sequence: with or without ground truth.
        seed: root seed of the system.
        progress: called with (frames done, frames in all).

    Raises:
        InputError: a frame cannot be read, or the camera is not one that the system takes.
    """
    looking, of_map = _Looking(), {}

    def at_end(system: SlamSystem, fed: Sequence) -> None:
        paths = system.trajectories()
        if paths:
            of_map.update(map_statistics(system.map(paths[0].map_id)))

    record = execute(sequence, "base", seed, observer=looking, progress=progress, at_end=at_end)
    tracked = [r for r in record.results if r.state is TrackingState.TRACKING and r.matches]
    values = {name: np.concatenate(parts) for name, parts in looking.found.items()} | of_map
    values["outliers"] = np.array([1 - r.inliers / r.matches for r in tracked])
    values["inliers"] = np.array([float(r.inliers) for r in tracked])
    summary = summarise(record)
    return Footage(
        sequence.name,
        {m.name: values.get(m.name, np.empty(0)) for m in MEASURES},
        _figures(record, summary, values),
        tuple(summary["scale_along"] or ()),
    )


def _figures(
    record: RunRecord, summary: dict, values: dict[str, np.ndarray]
) -> dict[str, float | int | None]:
    stamps_s, keyframes, path_m = record.sequence.stamps_s, summary["keyframes"], summary["true_path_m"]
    duration_s = float(stamps_s[-1] - stamps_s[0])
    residual = values.get("residual", np.empty(0))
    live = values.get("live_residual", np.empty(0))
    return {
        "frames": summary["frames"],
        "tracked_share": summary["share_tracked"],
        "maps": summary["maps"],
        "breakages": summary["breakages"],
        "camera_refined": sum(isinstance(e, CameraRefined) for e in record.events),
        "keyframes": keyframes,
        "keyframes_per_s": keyframes / duration_s if duration_s else None,
        "keyframes_per_m": keyframes / path_m if path_m else None,
        "path_m": path_m,
        "residual_over_1_sigma": _share(residual > 1),
        "residual_over_2_sigma": _share(residual > 2),
        "live_residual_over_2.45_sigma": _share(live > _REMOVED_FROM),
        "live_residual_over_5_sigma": _share(live > 5),
        "scale_first_over_last": summary["scale_first_over_last"],
        "ate_m": summary["ate_m"],
    }


def _share(holds: np.ndarray) -> float | None:
    return float(holds.mean()) if len(holds) else None
