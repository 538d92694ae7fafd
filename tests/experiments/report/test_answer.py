"""Answer of an experiment, and its conditions in words."""

import json

import pytest
from report_fakes import FakeSpec, fake_table
from test_documented_results import FOLDER

from experiments.eq1.former_spec import load_any_spec
from experiments.eq1.spec import load_spec, preset_names
from experiments.report.answer import answer
from experiments.report.conditions import conditions, describe_stress, dose_at, doses_of
from experiments.report.content import report_content
from experiments.statistics.analysis import AnalysisSettings

FEW = AnalysisSettings(draws=40, replicates=19)


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    spec = FakeSpec(doses=2, units=20)
    return report_content(spec, fake_table(spec, hardness=1.5), tmp_path_factory.mktemp("report"), FEW)


def test_the_answer_has_the_shares_of_the_statistics(results):
    rows = answer(results).rows
    assert [row.n for row in rows] == [1, 2]
    for row, level in zip(rows, results["kinds_of_world"]["levels"], strict=True):
        assert (row.measured, row.predicted) == (level["measured"]["value"], level["predicted_by_kind"])
        assert row.low <= row.measured <= row.high
        assert row.predicted_low <= row.predicted <= row.predicted_high


def test_the_answer_survives_the_file(results):
    assert answer(json.loads(json.dumps(results))) == answer(results)
    assert results["answer"]["sentences"] == answer(results).sentences


def test_the_answer_begins_with_the_verdict_and_names_what_was_tried(results):
    first, *rest = answer(results).sentences
    assert first.startswith("No verdict") and "too few" in first
    text = " ".join(rest)
    assert "low texture (contrast 0.3 and 0.1)" in text and "10 rendered worlds (corridor)" in text
    assert str(results["kinds_of_world"]["units"]) in text
    assert f"{results['units']['void']} trials without a healthy map" in text


def test_an_experiment_without_a_trial_has_no_result(tmp_path):
    spec = FakeSpec(doses=1)
    found = answer(report_content(spec, fake_table(spec, units=0), tmp_path, FEW))
    assert found.rows == [] and found.sentences[0].startswith("No result yet")


@pytest.mark.parametrize("preset", preset_names())
def test_every_dose_of_a_preset_has_a_name_and_a_unit(preset):
    spec = load_spec(preset)
    found = conditions(spec)
    assert [c["cell"] for c in found] == spec.cell_names()
    assert len({c["name"] for c in found}) == len(found)
    for condition in found:
        assert "_" not in condition["name"] and condition["dose"]
        for ending, unit in (("_s", "s"), ("_deg", "°"), ("_degps", "°/s"), ("_px", "px")):
            if condition["field"].endswith(ending):
                assert condition["axis"].endswith(f"({unit})") and condition["dose"].endswith(unit)


def test_doses_that_stand_for_a_severity_are_found_again():
    found = conditions(load_any_spec(FOLDER / "spec.yaml"))
    contrasts = doses_of(found, "low_texture")
    assert [d["value"] for d in contrasts] == [0.3, 0.15, 0.05]
    assert [dose_at(d["severity"], contrasts) for d in contrasts] == ["0.3", "0.15", "0.05"]
    assert dose_at(3.5, contrasts) == "0.1"
    assert (dose_at(9.0, contrasts), dose_at(0.1, contrasts)) == ("beyond 0.05", "beyond 0.3")
    assert describe_stress(found, "motion_blur") == "motion blur (exposure 0.06, 0.1 and 0.2 s)"
