"""The whole analysis on tables of records of known truth, and on tables with little in them."""

from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest
from experiment_tables import simulated_cell

from experiments.statistics.analysis import AnalysisSettings, analyse

pytestmark = pytest.mark.filterwarnings("error")
QUICK = AnalysisSettings(draws=200, replicates=99)


def _experiment(units=40, shared=0.0, kinds=("blur", "dark", "turn"), **more):
    rng = np.random.default_rng(1)
    return pd.concat(
        [
            simulated_cell(rng, f"{kind}/{s}", s, units, 0.1 + 0.15 * s, 0.1 + 0.1 * s, shared=shared, **more)
            for kind in kinds
            for s in (1, 2, 3)
        ],
        ignore_index=True,
    )


def _finite(value):
    if isinstance(value, dict):
        return all(map(_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_finite, value))
    return not isinstance(value, float) or np.isfinite(value)


@pytest.mark.slow
def test_nine_cells_are_analysed_and_every_figure_is_finite():
    found = analyse(_experiment(units_per_world=2), 2)
    assert _finite(asdict(found))
    assert [c.cell for c in found.cells] == [f"{k}/{s}" for k in ("blur", "dark", "turn") for s in (1, 2, 3)]


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_order_of_the_rows():
    table = _experiment(units=12, units_per_world=2, kinds=("blur",))
    assert analyse(table.sample(frac=1, random_state=3), 2, QUICK) == analyse(table, 2, QUICK)


@pytest.fixture(scope="module")
def blurred():
    """A table of three cells with some void units and an error, and its analysis."""
    table = _experiment(units=80, shared=1.0, kinds=("blur",))
    table.loc[0:2, "outcome"] = "void"
    table.loc[3, "outcome"] = "infrastructure_error"
    return table, analyse(table, 2, QUICK)


def test_counts_are_those_of_the_table(blurred):
    table, found = blurred
    rows = table[(table["cell"] == "blur/1") & (table["outcome"] == "completed")]
    cell = found.cells[0]
    assert (cell.units, cell.completed, cell.void, cell.errors) == (80, 76, 3, 1)
    assert cell.p0.events == rows["breakage"].sum()
    assert cell.p0.units == 76
    broken = rows[rows["breakage"]]
    thread = cell.threads[1]
    assert (thread.pr.events, thread.pr.units) == (rows["cross_r2_failed"].sum(), 76)
    assert (thread.pr_given_b.events, thread.pr_given_b.units) == (
        broken["free_r2_failed"].sum(),
        len(broken),
    )
    assert thread.stages == {"sim3": rows["cross_r2_failed"].sum()}
    level = cell.levels[1]
    assert level.measured.events == rows["d2"].sum()
    shares = [rows[name].mean() for name in ("breakage", "cross_r1_failed", "cross_r2_failed")]
    assert level.predicted.value == pytest.approx(float(np.prod(shares)))
    assert cell.frames_to_cross_free == 60


def test_the_prediction_is_the_crossing_arms_not_the_free_arms():
    table = _experiment(kinds=("blur",), units=120)
    table["cross_r1_failed"] = pd.array([False] * len(table), dtype="boolean")
    level = analyse(table, 2, QUICK).cells[2].levels[0]
    assert level.predicted.value == 0.0
    assert level.measured.events > 0
    assert level.ratio.value is None and level.ratio.low > 1 and level.ratio.high is None
    assert level.verdict == "optimistic"


@pytest.mark.slow
def test_many_units_in_which_eq1_holds_are_consistent_and_equivalent():
    rng = np.random.default_rng(2)
    found = analyse(simulated_cell(rng, "blur/1", 1, 1500, 0.4, 0.4), 2, QUICK).cells[0]
    assert [level.verdict for level in found.levels] == ["consistent", "consistent"]
    assert all(level.tost_p < 0.05 and level.power_ratio_2 > 0.99 for level in found.levels)
    assert found.threads[0].fisher_p > 0.01
    assert found.threads[0].rho.low < 1 < found.threads[0].rho.high


def test_shared_difficulty_is_called_optimistic_and_dependent():
    rng = np.random.default_rng(3)
    found = analyse(simulated_cell(rng, "blur/1", 1, 1500, 0.2, 0.2, shared=2.0), 2, QUICK)
    cell = found.cells[0]
    assert [level.verdict for level in cell.levels] == ["optimistic", "optimistic"]
    assert cell.levels[1].ratio.low > cell.levels[0].ratio.high
    assert cell.threads[0].rho.low > 1.2 and cell.rho_2_given_1.low > 1.2
    assert cell.threads[0].fisher_p < 1e-6
    mixture = found.heterogeneity.mixture
    assert mixture is not None and mixture.share_hopeless.low > 0.02
    uneven = {b.quantity: b for b in found.heterogeneity.beta_binomial}["crossings over units"]
    assert uneven.var_over_mean2 > 0.2 and uneven.p < 1e-6
    assert found.heterogeneity.beta_factor[0].beta.low > 0.02


def test_few_units_are_undecided_and_shared_worlds_are_noted():
    found = analyse(_experiment(units=12, units_per_world=4, kinds=("blur",)), 2, QUICK)
    assert found.cells[0].levels[1].verdict == "undecided" and found.cells[0].worlds == 3
    assert any("undecided" in note and "no support" in note for note in found.notes)
    assert any("share worlds" in note for note in found.notes)


def test_holm_corrects_over_the_tested_cells(blurred):
    _, found = blurred
    raw = [c.levels[0].lrt_p for c in found.cells]
    corrected = [c.levels[0].holm_p for c in found.cells]
    assert min(corrected) == pytest.approx(min(1.0, min(raw) * sum(p is not None for p in raw)))


def test_there_is_a_dose_response_per_kind_and_quantity(blurred):
    _, found = blurred
    assert [(d.kind, d.quantity) for d in found.dose_response[:3]] == [
        ("blur", "p0"),
        ("blur", "pr1"),
        ("blur", "pr2"),
    ]
    first = found.dose_response[0]
    assert [p.severity for p in first.points] == [1.0, 2.0, 3.0]
    assert first.slope.low > 0


def _all_failing(table):
    table["breakage"] = True
    for name in ("cross_r1_failed", "cross_r2_failed", "free_r1_failed", "free_r2_failed", "d1", "d2"):
        table[name] = True
    return table


def _none_failing(table):
    table["breakage"] = False
    for name in ("cross_r1_failed", "cross_r2_failed", "d1", "d2"):
        table[name] = False
    table[["free_r1_failed", "free_r2_failed", "reinit"]] = None
    return table


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.iloc[:0],
        lambda t: pd.DataFrame(),
        lambda t: t.assign(outcome="void"),
        lambda t: t.iloc[[0, 12]],
        _all_failing,
        _none_failing,
        lambda t: t.drop(columns=[c for c in t if c.startswith("cross_")]),
        lambda t: t.assign(severity=None).astype({"cross_r1_failed": object, "breakage": object}),
    ],
)
def test_tables_with_little_information_are_accepted(change):
    found = analyse(change(_experiment(units=8, kinds=("blur",)).copy()), 2, QUICK)
    assert _finite(asdict(found))
    assert all(level.verdict in ("undecided", "consistent") for c in found.cells for level in c.levels)


def test_without_a_crossing_arm_nothing_is_predicted():
    found = analyse(_experiment(units=20, kinds=("blur",), crossing=False), 2, QUICK)
    level = found.cells[0].levels[0]
    assert (level.predicted.value, level.lrt_p, level.tost_p) == (None, None, None)
    assert level.measured.units == 20
    assert level.verdict == "undecided"
    assert any("No crossing arm" in note for note in found.notes)


def test_eq1_holds_trivially_if_everything_fails():
    found = analyse(_all_failing(_experiment(units=40, kinds=("blur",))), 2, QUICK)
    assert [level.verdict for level in found.cells[0].levels] == ["consistent", "consistent"]


def test_no_recovery_thread_is_refused():
    with pytest.raises(ValueError):
        analyse(pd.DataFrame(), 0)
