"""The analysis: the first run's records, on whose figures two recomputations agree, and made-up tables."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dslab.experiments.statistics.analysis import analyse
from dslab.experiments.statistics.from_records import cells_of
from dslab.experiments.statistics.products import product_of_distinct

RECORDS = Path(__file__).resolve().parents[3] / "docs" / "eq1-quick"
TABLE = pd.read_parquet(RECORDS / "units.parquet")


@pytest.fixture(scope="module")
def found():
    return analyse(TABLE, 2, permutations=199)


def test_products_over_distinct_units_and_the_chain(found):
    """By units, as the recomputations took them; the analysis takes worlds."""
    assert (found.worlds, found.units, found.void) == (15, 522, 18)
    cells = cells_of(TABLE, 2)
    for n, expected in ((1, (0.253, 0.241, 0.272, 0.241)), (2, (0.196, 0.190, 0.213, 0.218))):
        each = [cell.outcomes.of_first(n) for cell in cells]
        in_worlds = [o.columns.reshape(1 + n, len(o.breakage), -1) for o in each]
        count = [np.isfinite(x).all(axis=0).sum(axis=1) for x in in_worlds]
        sums = [
            sum(float(product_of_distinct(x) @ k) for x, k in zip(in_worlds, count, strict=True)),
            sum(
                float(product_of_distinct(x.reshape(1 + n, -1)) * k.sum())
                for x, k in zip(in_worlds, count, strict=True)
            ),
            sum(np.nansum(np.prod(o.columns, axis=0)) for o in each),
            sum(np.nansum(o.dual_failures[-1]) for o in each),
        ]
        assert np.array(sums) / 522 == pytest.approx(expected, abs=1e-3)
    assert found.failed_or_silent == pytest.approx(0.274, abs=5e-4)
    by_worlds = found.failed_or_silent_by_worlds
    assert by_worlds.high - by_worlds.low > 0.15, "by worlds, not by units: .077"


def test_pooled_figures_are_means_over_cells_of_those_of_the_cells():
    first = pd.concat([made_up(20, seed=s, cell=f"blur/{s}") for s in range(3)])
    rows = first.assign(d2=first["d1"] & (first["repeat"] > 0), cross_r2_failed=first["cross_r1_failed"])
    void = (rows["cell"] == "blur/0") & (rows["world_seed"] < 9)
    rows["outcome"] = np.where(void, "void", "completed")
    found = analyse(rows, 2, permutations=99)
    for n, level in enumerate(found.levels, 1):
        cells = [cell for cell in found.cells if cell.n == n]
        assert (level.cells, len(cells)) == (3, 3)
        assert level.eq1 == pytest.approx(np.mean([cell.eq1 for cell in cells]))
        assert level.in_units == pytest.approx(np.mean([cell.in_units for cell in cells]))
        assert level.measured == pytest.approx(np.mean([cell.measured.value for cell in cells]))
        assert found.kinds_of_world[n - 1].measured.value == pytest.approx(level.measured)
        assert level.in_sequences is not None and level.in_worlds is None
    one, two = found.levels
    gain = found.formulas[1].second_thread.value
    assert gain == pytest.approx(two.first_alone - two.measured) == pytest.approx(one.measured - two.measured)


def test_no_formula_can_be_told_from_another_in_saturated_corridors(found):
    """Of these some are untested besides, since too few worlds have the event; nothing else has a verdict."""
    saturated = {(c.cell, c.n) for c in found.cells if c.world == "corridor" and c.saturated}
    both = {(f"{cell}", n) for cell in ("low_texture/3", "motion_blur/2", "motion_blur/3") for n in (1, 2)}
    assert saturated == both | {("fast_rotation/3", 1)}
    assert {str(v) for c in found.cells for v in (c.verdict_in_units, c.verdict_forecast)} == {
        "untested",
        "saturated",
    }
    (never,) = (c for c in found.cells if (c.cell, c.world, c.n) == ("fast_rotation/3", "corridor", 2))
    assert never.verdict_in_units == "untested" and never.worlds_with == (10, 5, 0)


def test_a_cell_is_split_by_kind_of_world_and_void_units_are_no_outcome():
    cells = cells_of(TABLE, 2)
    assert len(cells) == 18 and sum(cell.units for cell in cells) == 522
    corridor = next(c for c in cells if (c.name, c.world) == ("low_texture/1", "corridor"))
    assert corridor.outcomes.breakage.shape == (10, 4, 1) and corridor.void == 2
    assert np.isnan(corridor.outcomes.breakage).sum() == 2
    rows = TABLE[(TABLE.cell == "low_texture/1") & (TABLE.world == "corridor")]
    assert np.nansum(corridor.outcomes.breakage) == rows.breakage.fillna(False).sum()


def test_replicates_stand_in_their_sequences_and_shams_are_left_out():
    rows = TABLE[(TABLE.cell == "low_texture/1") & (TABLE.world == "corridor")].copy()
    rows["sequence"], rows["repeat"] = rows["index"] % 4 // 2, rows["index"] % 2
    (cell,) = cells_of(pd.concat([rows, rows.assign(kind="sham", cell="sham")]), 2)
    assert cell.outcomes.breakage.shape == (10, 2, 2)
    world, unit = cell.worlds[3], rows[rows.world_seed == cell.worlds[3]].iloc[-1]
    assert unit.world_seed == world and unit.outcome == "completed"
    assert cell.outcomes.breakage[3, int(unit["sequence"]), int(unit["repeat"])] == unit["breakage"]


def test_the_steps_of_the_chain_multiply_to_the_whole():
    rng = np.random.default_rng(3)
    worlds, sequences, repeats = 30, 3, 3
    index = np.arange(worlds * sequences * repeats)
    place = np.unravel_index(index, (worlds, sequences, repeats))
    hard = np.repeat(rng.uniform(0.2, 0.8, worlds), sequences * repeats)
    rows = pd.DataFrame({"world_seed": place[0], "sequence": place[1], "repeat": place[2], "index": index})
    rows = rows.assign(
        cell="a/1",
        world="room",
        kind="a",
        severity=1.0,
        outcome="completed",
        silent_failure=False,
        exposed=True,
    )
    rows["breakage"], rows["cross_r1_failed"] = rng.random(len(index)) < hard, rng.random(len(index)) < hard
    rows["d1"] = rows["breakage"] & (rng.random(len(index)) < hard)
    rows["s1"] = rows["d1"] | (rows["breakage"] & (index % 7 == 0))  # a first success that is false
    rows["m1"] = rows["s1"] | (index % 11 == 0)
    analysis = analyse(rows, 1, permutations=199)
    (found,), chance = analysis.cells, analysis.chance["room"]
    step = {name: ratio.value for name, ratio in found.steps.items()}
    assert set(step) == {"arms", "run", "path", "world", "whole"}
    assert np.prod([step[name] for name in ("arms", "run", "path", "world")]) == pytest.approx(step["whole"])
    assert all(ratio.low < ratio.value < ratio.high for ratio in found.steps.values())
    assert step["world"] > 1.05  # what a world shares; runs and paths share nothing here
    assert found.steps["run"].low < 1 < found.steps["run"].high
    assert 0.8 < chance.value < 1.0
    # A world without a valid unit in one cell still counts in the others.
    other = rows.assign(cell="b/1", outcome=np.where(rows["world_seed"] == 4, "void", "completed"))
    both, without = (
        analyse(some, 1, permutations=9).chance["room"].value
        for some in (pd.concat([rows, other], ignore_index=True), rows[rows["world_seed"] != 4])
    )
    assert min(chance.value, without) < both < max(chance.value, without)
    for name, column in (("dual_failure", "d1"), ("system_failure", "s1"), ("mission_failure", "m1")):
        assert found.shares[name].value == pytest.approx(rows[column].mean())
    assert found.shares["system_failure"].value > found.shares["dual_failure"].value
    once = analyse(rows[(rows["repeat"] == 0) & (rows["sequence"] == 0)], 1, permutations=199)
    assert set(once.cells[0].steps) == {"arms", "whole"} and not once.chance and not once.within_sequences


def made_up(worlds=12, sequences=1, repeats=3, seed=0, sham=False, **columns):
    """Records of one cell in which each world has its difficulty, shared by breakage and the one thread."""
    rng = np.random.default_rng(seed)
    place = np.unravel_index(np.arange(worlds * sequences * repeats), (worlds, sequences, repeats))
    rows = pd.DataFrame(dict(zip(("world_seed", "sequence", "repeat"), place, strict=True)))
    hard = rng.uniform(0.2, 0.9, worlds)[place[0]]
    broke, failed, crossed = (rng.random(len(rows)) < hard for _ in range(3))
    name, kind = ("sham", "sham") if sham else ("blur/1", "blur")
    rows = rows.assign(index=range(len(rows)), cell=name, kind=kind, severity=2.0, world="room")
    rows = rows.assign(outcome="completed", exposed=True, breakage=broke, silent_failure=False)
    rows = rows.assign(d1=broke & failed, s1=broke & failed, m1=broke, cross_r1_failed=crossed)
    return rows.assign(cross_r1_stage=np.where(crossed, "propagation", None)).assign(**columns)


@pytest.mark.parametrize(("worlds", "repeats"), [(1, 1), (1, 2), (2, 2), (3, 1), (4, 3)])
def test_no_design_is_too_small_and_few_worlds_are_untested(worlds, repeats):
    found = analyse(made_up(worlds, 1, repeats), 1, ("blur/1",), paper_threads=(1,), permutations=99)
    (cell,) = found.cells
    assert cell.worlds == worlds and cell.confirmatory
    assert cell.verdict_in_units == cell.verdict_forecast == "untested"
    assert (cell.eq1 is None) == (worlds < 3) and cell.measured.low <= cell.measured.value
    assert (len(found.within_sequences) == 1) == (repeats > 1)
    assert found.doses and bool(found.directions) == (worlds > 2)


def test_units_whose_stress_did_not_act_are_another_population():
    """In the trials that no stress reached nothing broke: with them Eq. 1 is refuted by the mixture alone."""
    acted = made_up(24)
    spared = made_up(24, seed=1, breakage=False, d1=False, s1=False, m1=False, cross_r1_failed=False)
    spared = spared.assign(index=spared["index"] + len(acted), world_seed=spared["world_seed"] + 24)
    mixed = pd.concat([acted.assign(exposed=True), spared.assign(exposed=False)], ignore_index=True)
    found, alone = (analyse(rows, 1, ("blur/1",), permutations=199) for rows in (mixed, acted))
    assert found.cells == alone.cells and found.levels == alone.levels and found.chance == alone.chance
    assert (found.units, found.unexposed, found.void) == (len(acted), len(spared), 0)
    (beside,) = found.without_stress
    assert beside.units == len(spared) and beside.measured.value == 0
    as_one = analyse(mixed.assign(exposed=True), 1, permutations=199).cells[0]
    assert as_one.shares["breakage"].value == pytest.approx(found.cells[0].shares["breakage"].value / 2)


def test_the_answer_within_sequences_is_deterministic_without_telling_ones():
    rows = made_up(24, 1, 3)
    same = rows.groupby("world_seed")["breakage"].transform("first")
    (test,) = analyse(rows.assign(breakage=same), 1, permutations=99).within_sequences
    assert (test.telling, test.p, test.ratio) == (0, None, None)
    (test,) = analyse(made_up(60, 1, 3), 1, permutations=199).within_sequences
    assert test.telling >= 20 and test.p > 0.01 and test.ratio == pytest.approx(1, abs=0.25)


def test_a_void_world_takes_no_world_of_another_kind_and_none_from_other_cells():
    corridor = made_up(24, seed=1, cell="blur/corridor", world="corridor")
    rooms = [made_up(24, seed=s, cell=f"blur/room{s}") for s in (2, 3)]
    void = rooms[0].assign(outcome=np.where(rooms[0]["world_seed"] < 4, "void", "completed"))
    found = analyse(pd.concat([corridor, void, rooms[1]]), 1, permutations=99)
    (test,), (formulas,) = found.within_sequences, found.formulas
    assert (formulas.worlds, len(formulas.cells), test.cells) == (48, 3, 3)
    telling = [
        analyse(table, 1, permutations=99).within_sequences[0].telling
        for table in (corridor, void[void["outcome"] == "completed"], rooms[1])
    ]
    assert test.telling == sum(telling)


def test_holm_corrects_the_confirmatory_cells_apart_from_the_others():
    rows = pd.concat([made_up(14, seed=s, cell=f"blur/{s}") for s in range(6)])
    named = analyse(rows, 1, ("blur/0",), permutations=999).cells
    assert [cell.confirmatory for cell in named] == [True] + [False] * 5
    (alone,) = analyse(rows[rows["cell"] == "blur/0"], 1, permutations=999).cells
    together = analyse(rows, 1, permutations=999).cells[0]
    assert named[0].p_forecast == alone.p_forecast < together.p_forecast


def test_only_the_first_threads_decide_where_the_spec_says_so():
    rows = made_up(14, cell="blur/0")
    alike = {f"{c}{n}": rows.breakage for c in ("d", "s", "m") for n in (1, 2)}
    rows = rows.assign(**alike, cross_r1_failed=rows.breakage, cross_r2_failed=rows.breakage)
    rows = rows.assign(cross_r1_stage=None, cross_r2_stage=None)
    both = analyse(rows, 2, ("blur/0",), permutations=999).cells
    first = analyse(rows, 2, ("blur/0",), permutations=999, confirmatory_threads=1).cells
    assert [(cell.n, cell.confirmatory) for cell in first] == [(1, True), (2, False)]
    (alone,) = analyse(rows, 1, ("blur/0",), permutations=999).cells
    assert first[0].p_forecast == alone.p_forecast and first[1].p_forecast < both[1].p_forecast


def test_parts_of_the_breakages_hold_all_of_them_once():
    rng = np.random.default_rng(1)
    rows = made_up(12)
    rows["rescuable"] = pd.array(np.where(rng.random(len(rows)) < 0.7, True, False), dtype="boolean")
    rows.loc[:3, "rescuable"] = pd.NA
    rows["declaration_delay_s"] = np.where(rows["breakage"], rng.choice([0.0, 0.3, 2.0], len(rows)), np.nan)
    found = analyse(pd.concat([rows, made_up(12, sham=True)]), 1, permutations=99)
    known = rows["breakage"] & rows["rescuable"].notna()
    assert sum(part.breakages for part in found.rescuable) == known.sum()
    assert sum(part.share.value for part in found.rescuable) == pytest.approx(1)
    delays = rows.loc[rows["breakage"], "declaration_delay_s"]
    assert [(part.part, part.breakages) for part in found.delays] == [
        ("up to 0.1 s", (delays == 0).sum()),
        ("0.1 to 0.5 s", (delays == 0.3).sum()),
        ("over 0.5 s", (delays == 2).sum()),
    ]
    hopeless = rows[known & ~rows["rescuable"].fillna(False).astype(bool)]
    # Worlds have as many units each, so that the share of units is that of worlds.
    assert found.rescuable[1].dual_failures[0].value == pytest.approx(hopeless["d1"].mean())
    assert [point.severity for point in found.doses] == [0.0, 2.0]
    assert found.sham[0].shares["mission_failure"].value > 0


def test_silence_is_a_share_of_the_unbroken_units():
    rows = made_up(60, repeats=1)
    unbroken = np.flatnonzero(~rows["breakage"])
    rows["silent_failure"] = rows["breakage"] | np.isin(np.arange(len(rows)), unbroken[:4])
    (cell,) = analyse(rows, 1, permutations=99).cells
    assert cell.shares["silent_failure"].value == pytest.approx(4 / len(unbroken))


def test_a_world_counts_in_a_share_of_a_part_by_what_it_has_of_it():
    """Ten worlds with three unbroken units and none silent, ten with one unbroken unit, which is silent."""
    rows = made_up(20)
    few, first = rows["world_seed"] >= 10, rows["repeat"] == 0
    silent = few & first
    rows = rows.assign(breakage=few & ~first, silent_failure=silent, rescuable=~(few & ~first))
    found = analyse(rows.assign(cross_r1_failed=silent), 1, permutations=99)
    share = found.cells[0].shares["silent_failure"]
    assert share == found.thread_shares[0].failed_rescuable
    assert share.value == pytest.approx(10 / 40) and 0.05 < share.low < share.high < 0.6
    never = analyse(rows.assign(cross_r1_failed=~rows["breakage"]), 1, permutations=99).thread_shares[0]
    assert never.failed_rescuable.value == 1 and 0.65 < never.failed_rescuable.low < 0.95


def test_p0_and_pr_are_compared_by_worlds():
    rows = made_up(20)

    def direction(failed, stage):
        table = rows.assign(cross_r1_failed=failed, cross_r1_stage=stage)
        (found,) = analyse(table, 1, paper_threads=(1,), permutations=99).directions
        return found

    alike = direction(rows["breakage"], np.where(rows["breakage"], "propagation", None)).declared
    assert (alike.difference.value, alike.p) == (0, 1) and alike.forward == alike.backward
    later = direction(True, "audit")
    broken = rows["breakage"].mean()
    assert later.declared.difference.value == pytest.approx(broken) and later.declared.p < 1e-3
    assert later.with_silent.backward.value == 1, "the audit's failures are failures by the second reading"
    rows["silent_failure"] = ~rows["breakage"]
    assert (
        direction(True, "audit").with_silent.difference.value == 0 and later.with_silent.difference.high < 0
    )
    never = rows.assign(cross_r2_failed=False, cross_r2_stage=None)
    first, second = analyse(never, 1, paper_threads=(1, 2), permutations=99).directions
    assert (first.thread, second.thread) == (1, 2) and second.declared.difference.low > 0, (
        "the second fails less"
    )
