"""A unit of a claim's experiment is measured again, held against its rows, and recorded if it can be seen."""

from dataclasses import replace

import pytest
from claim_fakes import KIND, SPEC

from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.loading import load_claim
from dslab.experiments.claims.replay import replay_claim
from dslab.experiments.claims.runner import run_claim
from dslab.experiments.jobs.pool import PoolSettings
from dslab.scenarios.errors import InputError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setitem(KINDS, "fake", KIND)
    (tmp_path / "made-up.yaml").write_text(SPEC.format(worlds=1))
    run_claim(load_claim(tmp_path / "made-up.yaml"), tmp_path / "out", PoolSettings(1))
    return tmp_path / "out"


def test_a_unit_agrees_with_its_rows_unless_it_is_measured_otherwise(folder, monkeypatch):
    unit, differing, has_rows = replay_claim(folder, "1")
    assert unit == {"condition": "room/motion_blur/1", "world": 0}
    assert differing == () and has_rows

    def otherwise(spec, unit):
        return [row | {"length_m": 1.0} for row in KIND.measure(spec, unit)]

    monkeypatch.setitem(KINDS, "fake", replace(KIND, measure=otherwise))
    assert replay_claim(folder, "1")[1] == ("length_m",)
    with pytest.raises(InputError, match="from 0 to 1"):
        replay_claim(folder, "2")


def test_only_what_can_be_seen_is_recorded(folder, monkeypatch, tmp_path):
    with pytest.raises(InputError, match="not recorded"):
        replay_claim(folder, "0", tmp_path / "unit.rrd")
    seen = []
    monkeypatch.setitem(KINDS, "fake", replace(KIND, record=lambda *given: seen.append(given[1:])))
    replay_claim(folder, "0", tmp_path / "unit.rrd")
    assert seen == [({"condition": "room", "world": 0}, tmp_path / "unit.rrd")]
