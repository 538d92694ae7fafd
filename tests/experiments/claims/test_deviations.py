"""The table of deviations says what docs/dual-slam.md says, and every one of them changes what it names."""

import re
from dataclasses import replace
from functools import reduce
from pathlib import Path

from dslab.experiments.claims.variants.deviations import (
    DEVIATIONS,
    NOT_ALONE,
    NOT_TRIED,
    PUBLISHED,
    deviation_variants,
    made,
    nested,
)
from dslab.experiments.runs.slam_settings import parse_slam_settings
from dslab.slam import orbslam
from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.dual.recovery.registry import build_thread

PAGE = (Path(__file__).parents[3] / "docs" / "dual-slam.md").read_text()
CAMERA = PinholeCamera(320, 240, 250.0, 250.0, 159.5, 119.5, 20.0)
PARAGRAPH = re.compile(r"^\*\*(?P<heading>[^*\n]+)\.\*\*(?P<text>.*?)(?=^\*\*|^## |\Z)", re.M | re.S)


def headings_of_page():
    """Per heading whether settings of its own stand in its paragraph, beside those in the made list."""
    found = {}
    for paragraph in PARAGRAPH.finditer(PAGE):
        _, _, settings = paragraph["text"].partition("*Setting:*")
        found[paragraph["heading"]] = bool(settings.strip() and not re.match(r"\s*none\b", settings))
    return found


def settings_of(system, written):
    """All settings of a system; a thread of its kind's own settings is the same as one with them written."""
    config, dual = parse_slam_settings(written, (), str).of(system, CAMERA)
    return (
        config,
        [build_thread(spec).config for spec in dual.recovery_threads],
        replace(dual, recovery_threads=()),
    )


def test_every_setting_of_the_page_is_undone_alone_or_says_why_not():
    page, table = headings_of_page(), {d.heading for d in DEVIATIONS} - {PUBLISHED}
    assert len(table) > 20 and table <= set(page)
    assert {heading for heading, has in page.items() if has} == set(NOT_ALONE)


def test_undone_ones_are_other_systems_and_made_again_they_are_ours():
    names = [variant["name"] for variant in deviation_variants("undone")]
    assert names == ["base", "dual", *(f"without-{d.name}" for d in DEVIATIONS)]
    for deviation in DEVIATIONS:
        system = "dual" if deviation.recovers else "base"
        assert settings_of(system, nested(made(deviation), "undone")) == settings_of(system, {}), (
            deviation.name
        )


def test_all_that_the_published_base_does_otherwise_is_tried_or_says_why_not():
    own, tried = SlamConfig(), {name for deviation in DEVIATIONS for name in deviation.undone}
    differing = {n for n, of in orbslam.PUBLISHED.items() if reduce(getattr, n.split("."), own) != of.value}
    left = {name for name in differing - tried if not any(name.startswith(key) for key in NOT_TRIED)}
    assert not left and len(differing) > 20


def test_what_the_published_profile_has_too_or_needs_more_is_not_made_on_it():
    made_on_it = {variant["name"]: variant for variant in deviation_variants("made")}
    assert not {"with-dropping", "with-evidence"} & set(made_on_it)  # in both; only behind frames passed over
    passing = made_on_it["with-passing-over"]
    assert passing["system"] == passing["against"] == "paper"
    threads = [{"kind": f"paper_{kind}", "config": {"max_unusable_s": 2.0}} for kind in ("orb", "sift")]
    assert passing["settings"] == {"dual": {"recovery_threads": threads}}
