"""Alignment against the truth: what is asked holds in a rendered world, and the basin is counted rightly."""

import pytest

from dslab.experiments.benchmarks import direct
from dslab.experiments.benchmarks.direct import ASKED, BASIN_PX, bench_direct


@pytest.mark.slow
def test_alignments_of_rendered_pairs_are_as_exact_as_asked(monkeypatch):
    monkeypatch.setattr(direct, "WORLDS", ("corridor",))
    monkeypatch.setattr(direct, "GAPS", (1, 5))
    monkeypatch.setattr(direct, "BASIN_PX", (4.0, 300.0))
    monkeypatch.setattr(direct, "_DURATION_S", 1.0)
    figures = bench_direct([301])
    row = figures["worlds"]["corridor"]
    assert figures["all"] == row and (row["pairs"], row["missed"]) == (6, 0)
    assert row["translation_share_median"] < ASKED["translation_share"]
    assert row["rotation_deg_median"] < ASKED["rotation_deg"]
    assert row["basin_px"] == 4.0 and 0.4 < row["basin_deg"] < 0.5
    assert set(figures["cpu_ms"]) >= {"pyramid", "alignment"} and 1 < figures["held_mb"]["corridor"] < 300


def test_the_basin_ends_before_the_first_offset_that_a_tenth_misses():
    def basin(shares):
        return direct._basin_px(
            [(px, i < 10 * s) for px, s in zip(BASIN_PX, shares, strict=False) for i in range(10)]
        )

    assert basin([1, 0.9, 0.8, 1, 1]) == BASIN_PX[1]
    assert basin([0.5]) == 0 and basin([]) == 0
    assert basin([1] * len(BASIN_PX)) == BASIN_PX[-1]


@pytest.mark.parametrize("seeds", ["x", "5-2", "-3", "1-"])
def test_seeds_out_of_form_are_one_line(dslab, seeds):
    code, out, err = dslab("bench", "direct", f"--seeds={seeds}")
    assert (code, out) == (2, "") and "write it as 7 or 1-10" in err


def test_an_alignment_that_is_not_found_is_missed():
    pairs = [direct._Pair("room", 1, *errors) for errors in ((1e-4, 0.01), (float("nan"),) * 2, (0.1, 0.01))]
    row = direct._row("room", pairs, [])
    assert (row["pairs"], row["missed"]) == (3, 2)
    assert direct._row("city", pairs, [])["rotation_deg_median"] is None
