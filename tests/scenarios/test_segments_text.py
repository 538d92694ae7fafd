"""Segments on a command line, and their models."""

from typing import Literal

import pytest

from dslab.scenarios.describe_fields import described_fields
from dslab.scenarios.errors import InputError
from dslab.scenarios.segment_text import parse_segment
from dslab.scenarios.segments import SEGMENT_KINDS, ImageSegment, Jpeg, LowLight


def test_a_text_gives_the_segment_with_its_defaults():
    segment = parse_segment("low_light: start_s=2, duration_s=1 ,illumination=0.1")
    assert segment == LowLight(kind="low_light", start_s=2, duration_s=1, illumination=0.1)
    assert segment.end_s == 3
    assert segment.severity["full_well_e"] == 10000


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("jpg:start_s=0", "unknown kind 'jpg'.*of your own comes with DSLAB_PLUGINS"),
        ("jpeg:start_s=0,duration_s=1,quality", "is no key=value"),
        ("jpeg:start_s=0,start_s=1,duration_s=1,quality=9", "start_s: is given twice"),
        ("jpeg:start_s=0,duration_s=1,qualty=9", "qualty.*unknown key"),
        ("jpeg:start_s=0,duration_s=1,quality=nan", "quality.*finite"),
    ],
)
def test_a_fault_of_the_text_names_its_place(text, problem):
    with pytest.raises(InputError, match=problem):
        parse_segment(text)


def test_every_kind_can_be_named():
    for kind in SEGMENT_KINDS:
        with pytest.raises(InputError, match="is missing"):
            parse_segment(kind)


def test_every_field_has_a_unit_or_a_description():
    for model in SEGMENT_KINDS.values():
        assert model.__doc__
        for name, field in model.model_fields.items():
            if name not in ("kind", "start_s", "duration_s", "axis"):
                unit = name.endswith(("_s", "_px", "_deg", "_degps", "_per_m", "_m", "_e", "stops"))
                assert unit or field.description, name


def test_two_ramps_fit_the_segment():
    Jpeg(kind="jpeg", start_s=0, duration_s=1, ramp_s=0.5, quality=5)
    with pytest.raises(ValueError, match=r"ramp_s = 0\.5"):
        Jpeg(kind="jpeg", start_s=0, duration_s=1, ramp_s=0.51, quality=5)


def test_a_field_may_hold_several_values(monkeypatch):
    class Tint(ImageSegment):
        kind: Literal["tint"]
        gains: tuple[float, float, float] = (1.0, 0.9, 0.8)
        names: tuple[str, ...] = ()

    monkeypatch.setattr("dslab.scenarios.segment_text.SEGMENT_KINDS", {"tint": Tint})
    segment = parse_segment("tint:start_s=1, gains = [1, .5,2],duration_s=2,names=[a]")
    assert isinstance(segment, Tint) and segment.gains == (1, 0.5, 2) and segment.names == ("a",)
    assert parse_segment("tint:start_s=1,duration_s=2,names=[]") == Tint(kind="tint", start_s=1, duration_s=2)
    for wrong in ("[1,2]", "[1,2,x]", "[1,2,3", "1"):
        with pytest.raises(InputError, match="gains"):
            parse_segment(f"tint:start_s=1,duration_s=2,gains={wrong}")
    fields = {name: span for name, span, _ in described_fields(Tint)}
    assert fields["gains"] == "default `[1.0, 0.9, 0.8]`"
