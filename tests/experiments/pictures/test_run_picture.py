"""The picture of runs shows every run, and nothing in it lies on anything else."""

import os
from dataclasses import replace

import numpy as np
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.pictures.run_picture import runs_figure
from dslab.experiments.runs.execution import execute
from dslab.sim.sequence import SegmentTruth
from dslab.slam.core.events import Breakage

KINDS = ("low_texture", "motion_blur", "fast_rotation", "repeated_texture", "covered_lens", "rain", "fog")


def segments(stamps_s, starts, frames):
    """A segment of one of the kinds after the other, ``frames`` long each."""
    spans = [(KINDS[i % len(KINDS)], start, start + frames) for i, start in enumerate(starts)]
    return tuple(SegmentTruth(kind, {}, stamps_s[a], stamps_s[b], a, b) for kind, a, b in spans)


def runs(kind: str):
    """Runs as different as a picture may have to show."""
    sequence = make_sequence(1 if kind == "one frame" else 300, segment=None)
    truthful = sequence
    if kind == "no truth":
        sequence = replace(sequence, T_world_cam=None)
    if kind == "many breakages":
        sequence = replace(sequence, segments=segments(sequence.stamps_s, range(0, 280, 20), 30 - 11))
    script = {"breaks_at": 160, "recovers": kind != "no truth"} if kind != "one frame" else {}
    names = ["base", "dual", "dual+"] if kind == "many breakages" else ["dual"]
    made = {name: execute(sequence, name, 0, build=fake_factory(truthful, **script)) for name in names}
    if kind == "many breakages":
        more = [
            Breakage(frame=f, stamp_s=f / 30, map_id=0, reason="x", inliers=0) for f in range(20, 300, 14)
        ]
        made = {name: replace(record, events=(*record.events, *more)) for name, record in made.items()}
    return made


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["no truth", "many breakages", "one frame"])
def test_no_axes_title_or_name_of_a_segment_lies_on_another(kind):
    records = runs(kind)
    figure = runs_figure(records)
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    boxes = [axes.get_window_extent(renderer) for axes in figure.axes]
    boxes += [text.get_window_extent(renderer) for axes in figure.axes for text in axes.texts]
    boxes += [axes.title.get_window_extent(renderer) for axes in figure.axes if axes.get_title().strip()]
    boxes += [legend.get_window_extent(renderer) for legend in figure.legends]
    size = figure.bbox
    assert all(
        box.x0 >= 0 and box.x1 <= size.width and box.y0 >= 0 and box.y1 <= size.height for box in boxes
    )
    # Half a pixel: neighbours may touch.
    padded = [box.padded(-0.5) for box in boxes]
    assert not any(one.overlaps(other) for i, one in enumerate(padded) for other in padded[:i])
    legend = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert kind == "one frame" or {*records, "breakage"} <= legend


def test_without_truth_the_breakage_is_marked_on_the_path_of_the_largest_map():
    (record,) = runs("no truth").values()
    figure = runs_figure({"dual": record})
    (path, mark) = (
        next(line for axes in figure.axes for line in axes.lines if line.get_label() == label)
        for label in ("dual", "breakage")
    )
    points = np.column_stack(path.get_data())
    # The last pose before the breakage.
    assert points[159] == pytest.approx(np.ravel(mark.get_data()))
    assert not any(line.get_label() == "truth" for axes in figure.axes for line in axes.lines)
    assert any("in one of 2 maps" in axes.get_title() for axes in figure.axes)


@pytest.mark.filterwarnings("error")
def test_any_name_is_drawn_as_it_is():
    """What matplotlib takes for mathematics or leaves out of legends, and bytes that are no UTF-8."""
    (record,) = runs("no truth").values()
    names = ["$a^{$", "_own", os.fsdecode(b"\xff")]
    figure = runs_figure(dict.fromkeys(names, record))
    figure.draw_without_rendering()
    drawn = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert {r"\$a^{\$", "\u200b_own", r"\udcff"} <= drawn
