"""A figure has one name and one value in a summary, a batch, a comparison and in Python."""

from dataclasses import replace

import pytest
from slam_fakes import fake_factory, make_sequence

from dslab import experiments
from dslab.experiments.batch.rows import COLUMNS, figures_of
from dslab.experiments.comparison.figures import FIGURES, comparison_content
from dslab.experiments.comparison.left_runs import find_runs
from dslab.experiments.evaluation.summary import given_frames


def test_figures_are_alike_wherever_they_stand(tmp_path):
    """Of a run that breaks, whose path before is longer than its share of the frames."""
    sequence = make_sequence()
    run = experiments.run(sequence, fake_factory(sequence, breaks_at=160, recovers=False))
    run.save(tmp_path / "run")
    row, table = figures_of(run.record, run.metrics), experiments.compare([run]).iloc[0].to_dict()
    ((system,),) = (s["systems"] for s in comparison_content(find_runs([tmp_path]))["sequences"])
    compared = {name: of["mean"] for name, of in system["figures"].items() if name != "robustness"}
    assert set(table) <= set(COLUMNS) and set(compared) == set(FIGURES) - {"robustness"} <= set(table)
    assert compared["completeness"] != pytest.approx(compared["path_share"], abs=1e-3)
    for name, value in table.items():
        assert row[name] == run.metrics[name] == value == compared.get(name, value)


def test_shares_are_of_all_frames_those_that_were_dropped_or_unreadable_too():
    sequence = make_sequence()
    whole = experiments.run(sequence, fake_factory(sequence)).record
    late = replace(whole, dropped_frames=60, unreadable_frames=40)
    all_of, part_of = (experiments.Run(record).metrics for record in (whole, late))
    assert given_frames(late) == len(sequence) + 100 and part_of["frames"] == all_of["frames"]
    for name in ("completeness", "share_tracked", "share_posed"):
        assert part_of[name] == pytest.approx(all_of[name] * 3 / 4)
