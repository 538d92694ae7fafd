"""Variants: rows of runs, paired figures of worlds, plots, and specs that are refused in a line."""

from types import SimpleNamespace

import pandas as pd
import pytest
import yaml
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.loading import PRESET_DIR, claim_presets, load_claim
from dslab.experiments.claims.variants import measure
from dslab.experiments.claims.variants.spec import Variant
from dslab.scenarios.errors import InputError

VARIANTS = KINDS["variants"]
PRESETS = [name for name in claim_presets() if load_claim(name).kind == "variants"]


# -- a run ---------------------------------------------------------------------------------------------------


def row_of(monkeypatch, system="dual", segment=(150, 180), **script):
    sequence = make_sequence(segment=segment)
    monkeypatch.setattr(measure, "factory_of", lambda settings: fake_factory(sequence, **script))
    return measure.run_variant(Variant(name="one", system=system), sequence, 3)


def test_a_rescue_counts_unless_the_truth_denies_it(monkeypatch):
    right = row_of(monkeypatch, breaks_at=160)
    assert (right["broke"], right["rescued"], right["failed"], right["repair"]) == (
        True,
        True,
        False,
        "recovery",
    )
    assert (
        right["reason"] == "few_inliers" and right["next_map_frames"] == 0
    )  # the stress ends with frame 180
    assert right["to_repair_s"] == pytest.approx(20 / 30) and right["recovery_cpu_s"] == pytest.approx(0.1)
    false = row_of(monkeypatch, breaks_at=160, new_map_scale=1.6)
    assert (
        false["repair"] == "recovery" and false["false_repair"] and not false["rescued"] and false["failed"]
    )
    assert false["false_claims"] == 1 and false["wrong"] and false["to_repair_s"] is None


def test_a_map_that_stays_lost_fails_with_the_reason_of_its_threads(monkeypatch):
    lost = row_of(monkeypatch, breaks_at=160, recovers=False)
    assert lost["failed"] and lost["rescued"] is False and lost["maps"] == 2
    assert lost["thread_reasons"] == "orb: overlap: no_common_points"
    assert 0.4 < lost["path_share"] < 0.6 and lost["onset_share"] == pytest.approx(0.5, abs=0.01)


def test_nothing_can_break_that_had_no_map_when_the_stress_began(monkeypatch):
    late = row_of(monkeypatch, system="base", starts_at=200)
    assert late["ready"] is False and [late[name] for name in ("broke", "rescued", "failed")] == [None] * 3
    assert late["first_map_frames"] == 201
    outside = row_of(monkeypatch, system="base", breaks_at=240, relocalizes_after=10)
    assert outside["breakages"] == 1 and outside["broke"] is False
    unstressed = row_of(monkeypatch, system="base", segment=None, breaks_at=240, relocalizes_after=10)
    assert unstressed["broke"] and unstressed["rescued"] and unstressed["repair"] == "relocalization"


def test_the_size_of_a_buffer_is_seen_from_outside(monkeypatch):
    class Held:
        nbytes = 3_000_000

    monkeypatch.setattr("slam_fakes.FakeSystem.buffer", Held(), raising=False)
    assert row_of(monkeypatch)["buffer_mb"] == 3.0


# -- figures -------------------------------------------------------------------------------------------------

WORLDS = 30
SPEC = """
kind: variants
name: made-up
claim: Less is worse.
section: III
root_seed: 5
worlds: 30
bases:
  room:
    world: {kind: room, length_m: 12, width_m: 9}
    camera: {width_px: 320, height_px: 240, fx_px: 250, fy_px: 250, cx_px: 159.5, cy_px: 119.5, fps: 20}
degradations:
  - {kind: motion_blur, dose: exposure_s, doses: [0.05, 0.1]}
sham: false
lead_in_s: 2
variants:
  - {name: whole, system: base}
  - {name: less, system: base, against: whole, settings: {initial_features: 2}}
  - {name: alike, system: base, against: whole}
"""


def spec_of(tmp_path, text=SPEC):
    (tmp_path / "made-up.yaml").write_text(text)
    return load_claim(tmp_path / "made-up.yaml")


def table_of(spec, worlds=WORLDS, **columns):
    """A row per world, condition and variant, of values that do not depend on the variant unless given."""
    rows = []
    for world in range(worlds):
        for condition in spec.cells:
            for variant in spec.variants:
                share = (7 * world % WORLDS) / WORLDS
                row = {"world": world, "condition": condition, "variant": variant.name, "exposed": True}
                row |= {"broke": share > 0.5, "failed": share > 0.5, "rescued": None, "path_share": share}
                row |= {"onset_share": share, "ate_m": 0.1 + share, "ate_share": 0.01 + share, "wrong": False}
                row |= {"tracked_share": share, "first_map_frames": 20 + world, "next_map_frames": None}
                row |= dict.fromkeys(("to_repair_s", "recovery_cpu_s", "buffer_mb", "cpu_ms"), 1.0 + share)
                rows.append(row | {name: of(row) for name, of in columns.items()})
    return pd.DataFrame(rows)


def test_differences_are_paired_by_world_and_told_by_holm(tmp_path):
    spec = spec_of(tmp_path)
    table = table_of(
        spec,
        path_share=lambda row: row["path_share"] * (0.9 if row["variant"] == "less" else 1.0),
        ate_m=lambda row: None if row["variant"] == "alike" and row["world"] < 4 else row["ate_m"],
        exposed=lambda row: row["world"] >= 2 or row["condition"].endswith("/1"),
    )
    found = VARIANTS.figures(spec, table)
    rows = {(r["variant"], r["measure"], r["condition"]): r for r in found["contrasts"]}
    pooled = rows["less", "path_share", ""]
    assert -0.06 < pooled["low"] < pooled["value"] < pooled["high"] < -0.02
    assert pooled["worlds"] == 30 and pooled["better"] is False  # less of the path
    assert pooled["p"] == pytest.approx(2e-4)  # of 10,000 exchanges none is larger; two contrasts
    assert rows["less", "path_share", "room/motion_blur/2"]["worlds"] == 28  # not exposed in two
    same = rows["alike", "log_ate", ""]
    assert (same["value"], same["p"], same["worlds"]) == (0.0, 1.0, 26) and same["left_out"] == 6
    assert same["better"] is None
    assert found["untold"] == ["alike"] and found["unexposed"] == 6
    *sentences, told, _ = found["answer"]
    assert "share of the path in the largest map: 3 of 6 differences are told from 0" in sentences
    assert {(row["variant"], row["measure"]) for row in told} == {("less", "path_share")}
    axes = VARIANTS.draw(spec, found, 7.6).axes
    rows = [text.get_text() for text in axes[0].get_yticklabels()]
    assert len(axes) == 4 and rows == ["less", "alike"]  # of which the upper one is told, in black
    black = [[line.get_color() for line in own.lines if line.get_marker() == "o"] for own in axes]
    assert [colours.count("black") for colours in black] == [0, 0, 1, 0]


def test_less_of_an_error_is_better_and_less_of_the_path_is_not(tmp_path):
    spec = spec_of(tmp_path)
    shrunk = {
        name: lambda row, name=name: row[name] * (0.9 if row["variant"] == "less" else 1.0)
        for name in ("path_share", "ate_m")
    }
    found = VARIANTS.figures(spec, table_of(spec, **shrunk))
    rows = {(r["variant"], r["measure"], r["condition"]): r for r in found["contrasts"]}
    assert rows["less", "path_share", ""]["better"] is False
    assert rows["less", "log_ate", ""]["better"] is True


def test_the_middle_of_a_histogram_is_counted_by_worlds(tmp_path):
    spec = spec_of(tmp_path, SPEC + "plot: histogram\nmeasures: [path_share, ate_share]\n")
    table = table_of(
        spec, path_share=lambda row: 0.7 if row["world"] < 3 else 0.2 if row["world"] < 15 else 1.0
    )
    middle = VARIANTS.figures(spec, table)["middle"][0]
    assert (middle["below_runs"], middle["between_runs"], middle["above_runs"]) == (24, 6, 30)
    between = middle["between"]
    assert between["value"] == pytest.approx(0.1) and between["worlds"] == 30
    assert 0.02 < between["low"] < 0.05 and 0.2 < between["high"] < 0.3  # of 30 worlds, not of 60 runs
    assert middle["onset_between"]["value"] == pytest.approx(11 / 14)  # .6 to .95 of the 14 above .5


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_described_and_drawn(name):
    spec = load_claim(name)
    assert spec.name == name and spec.description and spec.worlds >= 30 and spec.unit_s
    assert spec.unit_s <= 180 and yaml.safe_load((PRESET_DIR / f"{name}.yaml").read_text())["root_seed"]
    if spec.plot != "forest":
        drawn = VARIANTS.draw(spec, VARIANTS.figures(spec, table_of(spec, worlds=6)), 7.6)
        assert len(drawn.axes) >= 2 and drawn.axes[0].has_data()


# -- specs ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("initial_features: 2", "initial_feature: 2", "variant less: settings.initial_feature: unknown key"),
        ("initial_features: 2", "initial_features: -2", "variant less: settings.initial_features"),
        ("initial_features: 2", "mode: threaded", "variant less: settings.mode: variants run in lockstep"),
        ("system: base}", "system: bass}", "variant whole: system: there is no system 'bass'; give base"),
        ("against: whole}", "against: hole}", "no other one 'hole'"),
        ("name: alike", "name: less", "two variants are named less"),
        ("lead_in_s: 2", "measures: [fails]", "there is no fails"),
    ],
)
def test_a_fault_of_a_spec_is_one_line(tmp_path, old, new, fault):
    assert old in SPEC
    with pytest.raises(InputError) as raised:
        spec_of(tmp_path, SPEC.replace(old, new, 1))
    assert fault in str(raised.value) and "\n" not in str(raised.value)


def test_parts_of_a_world_have_the_same_frames_and_seeds(tmp_path, monkeypatch):
    spec = spec_of(tmp_path).model_copy(update={"most_variants": 2, "worlds": 1})
    units = VARIANTS.units(spec)
    assert [unit["variants"] for unit in units[:2]] == [["whole", "less"], ["alike"]] and len(units) == 4
    monkeypatch.setattr(
        measure, "render_sequence", lambda scenario: SimpleNamespace(segments=(), scenario=scenario)
    )
    seen = []
    monkeypatch.setattr(measure, "run_variant", lambda *ran: seen.append(ran) or {})
    for unit in units[:2]:
        VARIANTS.measure(spec, unit)
    first, *others = [(sequence.scenario, seed) for _, sequence, seed in seen]
    assert len(others) == 2 and all(other == first for other in others)


def test_no_variant_is_always_the_first_of_its_unit(tmp_path, monkeypatch):
    """Times are measured, and may depend on the place."""
    spec = spec_of(tmp_path).model_copy(update={"worlds": 12})
    monkeypatch.setattr(measure, "render_sequence", lambda scenario: SimpleNamespace(segments=()))
    ran = []
    monkeypatch.setattr(
        measure, "run_variant", lambda variant, *_: ran.append(variant.name) or {"variant": variant.name}
    )
    firsts = set()
    for unit in VARIANTS.units(spec):
        start = len(ran)
        assert [row["variant"] for row in VARIANTS.measure(spec, unit)] == unit["variants"]
        firsts.add(ran[start])
    assert len(firsts) == 3


def test_a_folder_is_read_whose_settings_are_gone(tmp_path):
    """Its rows were measured by code that had them; what is run now is told."""
    (tmp_path / "spec.yaml").write_text(SPEC.replace("initial_features: 2", "initial_feature: 2", 1))
    less = next(variant for variant in load_claim(tmp_path).variants if variant.name == "less")
    with pytest.raises(InputError, match=r"variant less: settings\.initial_feature: unknown key"):
        _ = less.written
