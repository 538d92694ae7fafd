"""Answer of an experiment, and its conditions in words."""

import json

import pytest
from report_fakes import FakeSpec, fake_table
from test_documented_results import FIRST

from dslab.experiments.campaign.folder import read_experiment, read_spec
from dslab.experiments.eq1.spec import load_spec, preset_names
from dslab.experiments.report.answer import MEANINGS, answer
from dslab.experiments.report.conditions import conditions, describe_stress, doses_of
from dslab.experiments.report.content import report_content


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    spec = FakeSpec(doses=2, units=20)
    return report_content(spec, fake_table(spec, hardness=1.5), tmp_path_factory.mktemp("report"), 99)


def test_the_answer_survives_the_file(results):
    assert answer(json.loads(json.dumps(results))) == answer(results)
    assert results["answer"]["sentences"] == answer(results).sentences
    assert results["answer"]["rows"] == results["analysis"]["kinds_of_world"]


def test_the_paragraph_says_what_was_asked_tried_found_and_not_said(results):
    text = " ".join(answer(results).sentences)
    for part in ("Asked: ", "Tried: ", "How sure: ", "Not said: ", "all are exploratory", "decide little"):
        assert part in text
    assert answer(results).headline.endswith("both break and fail to recover.")
    few = [cell | {"worlds": 9} for cell in results["analysis"]["cells"]]
    few_worlds = answer(results | {"analysis": results["analysis"] | {"cells": few}})
    assert few_worlds.headline.endswith("; 9 were run.")
    assert "low texture (contrast 0.3 and 0.1)" in text and "10 rendered worlds (corridor)" in text
    assert f"{results['units']['completed']} trials" in text and "without a healthy map" in text


def test_without_the_free_arm_eq1_is_not_asked_but_what_threads_cross():
    folder = FIRST.parent / "direct-thread"
    found = report_content(*read_experiment(folder), folder, 99)["answer"]
    text = " ".join(found["sentences"])
    assert found["headline"] == "Eq. 1 is not asked: only the crossing arm ran." and found["rows"] == []
    assert "ORB in 45.0 % to 61.9 %, SIFT in 34.4 % to 44.4 % and direct in 40.0 % to 40.6 %" in text
    assert "in 97 trials, direct crosses 28.6 % to 35.4 %" in text


def judged(*words: str, confirmatory: bool = False) -> list[dict]:
    each = {"n": 1, "confirmatory": confirmatory, "worlds": 12}
    return [each | {"verdict_forecast": word, "verdict_in_units": word} for word in words]


@pytest.mark.parametrize(
    ("words", "headline"),
    [
        (["optimistic", "saturated", "untested"], "Eq. 1 predicted too few failures in 1 of 3 tests."),
        (
            ["optimistic", "pessimistic"],
            "predicted too few failures in 1 and too many failures in 1 of 2 tests.",
        ),
        (["consistent", "undecided"], "Eq. 1 agrees in 1 of 2 tests, and in none it is refuted."),
        (
            ["undecided", "untested"],
            "Undecided: too few worlds in 1 of 2 tests. The others could not be tested.",
        ),
        (["saturated", "saturated"], "No verdict on Eq. 1: where all fails, any formula is right."),
        (["untested"] * 2, "Untested: in no condition did 10 worlds both break and fail to recover."),
    ],
)
def test_the_headline_follows_the_verdicts_of_the_confirmatory_conditions(results, words, headline):
    analysis = results["analysis"] | {"cells": judged(*words)}
    found = answer(results | {"analysis": analysis})
    assert found.headline.endswith(headline)
    refuted = sum(word in ("optimistic", "pessimistic") for word in words)
    assert ("not independent" in found.headline) == (
        f"in {refuted} of {len(words)} tests. " in found.headline
    )
    assert bool(refuted) == ("not independent" in found.headline)
    told = next(sentence for sentence in found.sentences if sentence.startswith("With ORB, of"))
    assert all(f"{words.count(word)} {word} ({MEANINGS[word]})" in told for word in words)
    both = judged("optimistic") + judged(*words, confirmatory=True)
    named = answer(results | {"analysis": analysis | {"cells": both}})
    assert named.headline == found.headline and "named before the run" in " ".join(named.sentences)


def test_an_experiment_without_a_trial_has_no_result(tmp_path):
    spec = FakeSpec(doses=1)
    found = answer(report_content(spec, fake_table(spec, units=0), tmp_path, 99))
    assert found.rows == [] and found.headline.startswith("No result yet")


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


def test_doses_are_named_in_the_order_of_the_spec():
    found = conditions(read_spec(FIRST))
    assert [d["value"] for d in doses_of(found, "low_texture")] == [0.3, 0.15, 0.05]
    assert describe_stress(found, "motion_blur") == "motion blur (exposure 0.06, 0.1 and 0.2 s)"
