"""Inliers over time and, per system, which frames have a pose."""

from collections.abc import Sequence as Many

import numpy as np
from matplotlib.axes import Axes

from dslab.experiments.evaluation.frame_outcomes import FrameOutcome
from dslab.experiments.pictures import palette
from dslab.experiments.pictures.path_panel import DrawnRun
from dslab.scenarios.describe import describe_kind
from dslab.sim.sequence import SegmentTruth

_MOST_ROWS = 3
_LABEL_SHARE = 0.0062
"""Width of a letter of a segment's label, as a share of the axes."""


def draw_inliers(axes: Axes, runs: Many[DrawnRun], segment_colors: dict[str, str]) -> None:
    """Draw inliers over time, with the segments named above."""
    # A single frame has no span.
    axes.set_xlim(0, max(_times_s(runs[0])[-1], 1e-3))
    draw_spans(axes, runs[0], segment_colors)
    _name_segments(axes, runs[0])
    for place, run in enumerate(runs):
        later = len(runs) - 1 - place
        axes.plot(
            _times_s(run),
            [r.inliers for r in run.record.results],
            color=run.color,
            # All curves are equal up to the first breakage; the widest is drawn first.
            linewidth=1.2 + 1.4 * later,
            alpha=0.5 if later else 0.9,
        )
    # Direct odometry counts pixels, several times as many as others have features; a square root shows both.
    axes.set_yscale("function", functions=(lambda n: np.sqrt(np.maximum(n, 0)), np.square))
    # The few frames of an initialization have many more inliers and would flatten the curves.
    every = [r.inliers for run in runs for r in run.record.results]
    axes.set_ylim(0, 1.25 * max(1.0, float(np.percentile(every, 98))))
    axes.set_ylabel("inliers", fontsize=8)
    axes.tick_params(labelsize=8, labelbottom=False)


def draw_lanes(axes: Axes, runs: Many[DrawnRun], segment_colors: dict[str, str]) -> None:
    """Draw one lane per system: a bar where frames have a pose, breakages and repairs as in the path."""
    draw_spans(axes, runs[0], segment_colors)
    for lane, run in enumerate(runs):
        times_s = _times_s(run)
        for outcome, color in (
            (FrameOutcome.TRACKED, run.color),
            (FrameOutcome.RECOVERED, palette.RECOVERED),
        ):
            inside = np.array([frame is outcome for frame in run.frames], bool)
            bar = {"where": inside, "step": "mid", "color": color, "alpha": 0.6, "linewidth": 0}
            axes.fill_between(times_s, lane - 0.22, lane + 0.22, **bar)
        for outcome in run.outcomes:
            marks = {outcome.breakage: ("x", palette.BREAKAGE), outcome.relocalized: ("D", palette.HEALED)}
            marks |= {outcome.joined: ("s", palette.HEALED)}
            marks |= {outcome.fusion if outcome.recovered else None: ("o", palette.HEALED)}
            for event, (marker, color) in marks.items():
                if event is not None:
                    style = {"color": color, "markersize": 7, "markeredgewidth": 1.8, "zorder": 5}
                    axes.plot(times_s[event.frame], lane, marker, **style)
    axes.set_ylim(len(runs) - 0.4, -0.6)
    axes.set_yticks(range(len(runs)), [run.name for run in runs])
    axes.tick_params(labelsize=8, left=False)
    axes.set_xlabel("s since the first frame; bars where frames have a pose in the end", fontsize=8)


def draw_spans(axes: Axes, run: DrawnRun, segment_colors: dict[str, str]) -> None:
    """Shade the time of every segment."""
    for segment in _acting(run):
        axes.axvspan(*_span_s(run, segment), color=segment_colors[segment.kind], alpha=0.6, zorder=0)


def _name_segments(axes: Axes, run: DrawnRun) -> None:
    """Write names above the axes, in rows without overlap; the legend has the others."""
    low, high = axes.get_xlim()
    ends = [-np.inf] * _MOST_ROWS
    for segment in sorted(_acting(run), key=lambda s: s.first_frame):
        name = describe_kind(segment.kind)
        half = 0.5 * len(name) * _LABEL_SHARE
        middle = float(np.clip((np.mean(_span_s(run, segment)) - low) / (high - low), half, 1 - half))
        row = next((row for row, end in enumerate(ends) if middle - half > end), None)
        if row is not None:
            ends[row] = middle + half
            axes.annotate(
                name,
                (middle, 1),
                xytext=(0, 3 + 11 * row),
                textcoords="offset points",
                xycoords="axes fraction",
                ha="center",
                fontsize=8,
            )


def _acting(run: DrawnRun) -> list[SegmentTruth]:
    return [segment for segment in run.record.sequence.segments if segment.first_frame >= 0]


def _span_s(run: DrawnRun, segment: SegmentTruth) -> np.ndarray:
    return _times_s(run)[[segment.first_frame, segment.last_frame]]


def _times_s(run: DrawnRun) -> np.ndarray:
    """(N,) times since the first frame."""
    return run.record.sequence.stamps_s - run.record.sequence.stamps_s[0]
