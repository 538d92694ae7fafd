"""Batches in the layout of the paper's Figures 6 to 9: what is drawn is what the runs have left."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.batch import paper_figures
from dslab.experiments.batch.paper_figures import (
    OTHER_DATA,
    draw_end_errors,
    draw_initialisation,
    draw_overlays,
    draw_profiles,
    write_figures,
)
from dslab.experiments.batch.rows import figures_of, typed
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.result_folder import write_run
from dslab.experiments.runs.execution import execute

FRAMES, BROKE = 300, 150


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """Two trials of a base that is lost for good, one of a Dual-SLAM that recovers."""
    folder, sequence = tmp_path_factory.mktemp("batch"), make_sequence(FRAMES)
    sequence = replace(sequence, stamps_s=sequence.stamps_s * 3)  # half a minute
    rows = []
    for system, run in (("base", 0), ("base", 1), ("dual", 0)):
        record = execute(sequence, system, 0, build=fake_factory(sequence, breaks_at=BROKE + run))
        summary = summarise(record)
        place = f"runs/{system}/{run}"
        (folder / place).mkdir(parents=True)
        write_run(folder / place, record, summary, picture=False)
        about = {"source": "circle", "sequence": "circle", "system": system, "run": run, "folder": place}
        rows.append({**about, "first_frame": 0, **figures_of(record, summary)})
    return typed(rows, ["base", "dual"]), folder


def marked(figure) -> bool:
    return OTHER_DATA in figure.get_supxlabel()


def test_figure_6_has_the_frames_to_the_first_pose_of_every_trial(batch):
    rows, _ = batch
    assert rows.frames_to_initialise.tolist() == [6, 6, 6]
    figure = draw_initialisation(rows)
    assert marked(figure) and [bar.get_height() for bar in figure.axes[0].patches[:3:2]] == [6, 6]
    never = rows.assign(frames_to_initialise=pd.array([None, 6, 6], "Int64"))
    hatched = [bar.get_hatch() for bar in draw_initialisation(never).axes[0].patches]
    assert hatched[0] == "///" and hatched.count(None) >= 2


def test_figure_7_is_white_where_a_trial_has_no_pose(batch):
    rows, folder = batch
    base, dual = (np.asarray(axes.images[0].get_array()) for axes in draw_profiles(rows, folder).axes)
    assert base.shape == (FRAMES, 2) and dual.shape == (FRAMES, 1)
    tracked = list(paper_figures._PARTS).index("tracked")
    assert (base[10:BROKE, 0] == tracked).all() and not base[BROKE:, 0].any()
    assert base[BROKE, 1] == tracked and not base[BROKE + 1 :, 1].any()
    assert (dual[-50:] == tracked).all()


def test_figure_8_has_the_truth_and_what_covers_it(batch):
    rows, folder = batch
    for axes, posed in zip(draw_overlays(rows, folder).axes, (BROKE - 5, FRAMES - 25), strict=True):
        truth, slam = axes.get_lines()
        assert len(truth.get_xdata()) == FRAMES
        covered = np.isfinite(slam.get_xdata())
        assert covered.sum() == pytest.approx(posed, abs=3)
        np.testing.assert_allclose(slam.get_xdata()[covered], truth.get_xdata()[covered], atol=1e-3)


def test_figure_9_has_the_error_of_intact_maps_and_black_for_the_others(batch):
    rows, _ = batch
    assert rows.intact.tolist() == [False, False, True]
    base, dual = draw_end_errors(rows).axes[:2]
    shade, errors = base.images
    assert np.ma.getmaskarray(errors.get_array()).all() and not np.asarray(shade.get_array()).any()
    assert dual.images[1].get_array()[0, 0] == pytest.approx(rows.end_alignment_m[2])
    # The second trial of Dual-SLAM was not made: it is not known, and no failure.
    assert np.asarray(dual.images[0].get_array()).ravel().tolist() == [1, 1]


@pytest.mark.slow
def test_figures_are_written_and_what_has_no_runs_is_left_out(batch, tmp_path):
    rows, folder = batch
    assert [path.name for path in write_figures(rows, folder)] == [f"figure_{n}.png" for n in (6, 7, 8, 9)]
    assert (folder / "figures" / "figure_7.svg").read_bytes().startswith(b"<?xml")
    # The result folders were removed: Figure 7 is white, Figure 8 has nothing to show.
    assert "figure_8.png" not in {path.name for path in write_figures(rows, tmp_path)}
    assert write_figures(rows.assign(ended="error"), tmp_path) == []
