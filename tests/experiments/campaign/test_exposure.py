"""Whether a stress acts, drawn before an experiment."""

import pytest

from dslab.experiments.campaign import exposure
from dslab.experiments.campaign.exposure import draw_exposure
from dslab.experiments.eq1.spec import load_spec


@pytest.mark.slow
def test_a_cell_whose_stress_seldom_acts_is_found_before_it_runs(monkeypatch):
    monkeypatch.setattr(exposure, "DRAWN_WORLDS", 4)
    spec = load_spec("eq1").model_copy(update={"worlds": 4})
    kept = [
        d.model_copy(update={"doses": d.doses_of("corridor")})
        for d in spec.degradations
        if d.kind in ("low_texture", "fast_rotation")
    ]
    of_corridor = {"bases": {"corridor": spec.bases["corridor"]}, "degradations": tuple(kept)}
    spec = spec.model_copy(update=of_corridor)
    drawn = {cell.cell: cell for cell in draw_exposure(spec)}
    assert len(drawn) == 2 and [cell.is_exposed for cell in drawn.values()] == [False, True]
    always = kept[0].model_copy(update={"fields": {**kept[0].fields, "view_share": 0.8}})
    spec = spec.model_copy(update={"degradations": (always,)})
    assert all(cell.acted == 4 for cell in draw_exposure(spec))
    assert draw_exposure(spec.model_copy(update={"worlds": 3})) == []
