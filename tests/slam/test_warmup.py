"""The warm-up compiles all kernels, so that no run has to."""

import pytest

from dslab.slam import factory
from dslab.slam.warmup import warm_up


@pytest.mark.slow
def test_the_warmup_runs_three_recovery_threads_a_fusion_and_a_relocalization(monkeypatch):
    built, build, told = {}, factory.build_system, []

    def build_system(kind, *arguments, **options):
        built[kind] = build(kind, *arguments, **options)
        return built[kind]

    monkeypatch.setattr(factory, "build_system", build_system)
    warm_up(lambda *progress: told.append(progress))
    dual = built["dual"].events
    ends = [(e.method, e.success) for e in dual if e.kind == "recovery_end"]
    assert ends == [("orb", True), ("sift", True), ("direct", True)]
    assert [e.accepted for e in dual if e.kind == "fusion"] == [True]
    assert "relocalized" in [e.kind for e in built["base"].events]
    assert "initialized" in [e.kind for e in built["dual+"].events]
    assert "initialized" in [e.kind for e in built["ldso"].events]
    assert told[-1][1:] == (len(told) - 1, len(told) - 1)
