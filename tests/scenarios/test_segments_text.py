"""Segments as words of a command line, and their models."""

import pytest

from scenarios.errors import InputError
from scenarios.segment_text import parse_segment
from scenarios.segments import SEGMENT_KINDS, Jpeg, LowLight


def test_a_word_gives_the_segment_with_its_defaults():
    segment = parse_segment("low_light: start_s=2, duration_s=1 ,illumination=0.1")
    assert segment == LowLight(kind="low_light", start_s=2, duration_s=1, illumination=0.1)
    assert segment.end_s == 3
    assert segment.severity["full_well_e"] == 10000


def test_every_kind_can_be_named():
    for kind in SEGMENT_KINDS:
        with pytest.raises(InputError, match="is missing"):
            parse_segment(kind)


@pytest.mark.parametrize("model", SEGMENT_KINDS.values(), ids=list(SEGMENT_KINDS))
def test_every_field_says_its_unit_or_what_it_means(model):
    for name, field in model.model_fields.items():
        if name not in ("kind", "start_s", "duration_s", "axis"):
            unit = name.endswith(("_s", "_px", "_deg", "_degps", "_per_m", "_m", "_e", "stops"))
            assert unit or field.description, name
    assert model.__doc__


def test_two_ramps_fit_the_segment():
    Jpeg(kind="jpeg", start_s=0, duration_s=1, ramp_s=0.5, quality=5)
    with pytest.raises(ValueError, match=r"ramp_s = 0\.5"):
        Jpeg(kind="jpeg", start_s=0, duration_s=1, ramp_s=0.51, quality=5)
