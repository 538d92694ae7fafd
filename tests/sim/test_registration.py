"""Worlds, motions and degradations of one's own count like those that come with the lab."""

from typing import ClassVar, Literal

import numpy as np
import pytest
from degradation_worlds import digest, small_backend, small_scenario

from dslab import scenarios, sim
from dslab.scenarios import motions
from dslab.scenarios.extensions import extension_digests
from dslab.scenarios.schema import json_schema
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.scenarios.worlds import WORLD_KINDS
from dslab.sim.degradations import registry
from dslab.sim.motion import _PLANS, plan_motion
from dslab.sim.motion.walker import plan_walk
from dslab.sim.provenance import sources
from dslab.sim.worlds import WORLDS, room


class Inverted(scenarios.ImageSegment):
    """Light becomes dark."""

    kind: Literal["inverted"]
    share: float


class Inversion(sim.ImageDegradation[Inverted]):
    kind: ClassVar[str] = "inverted"
    stage: ClassVar[sim.Stage] = sim.Stage.ENCODER
    measure_name: ClassVar[str] = "inverted_share"

    def sample(self, rng):
        return {"share": float(rng.random())}

    def prepare(self, segment, camera, streams):
        def invert(image, view):
            share = segment.share * view.strength
            return (image + share * (255.0 - 2.0 * image)).astype(np.uint8), share

        return invert

    def threshold(self, segment):
        return 0.5 * segment.share


class Shed(scenarios.Lamps):
    kind: Literal["shed"] = "shed"
    size_m: float = 6.0


@pytest.fixture
def inverted():
    sim.register_degradation(Inverted, Inversion())
    yield
    SEGMENT_KINDS.remove("inverted")
    for kinds in (registry.DEGRADATIONS, registry.IMAGE_KINDS):
        del kinds["inverted"]


def test_a_degradation_of_ones_own_acts_and_is_measured(inverted, tmp_path):
    scenario = small_scenario("room", {"kind": "inverted", "start_s": 0.2, "duration_s": 0.4, "share": 1.0})
    backend = small_backend()
    plain = sim.render(small_scenario("room"), cache_dir=tmp_path, backend=backend)
    sequence = sim.render(scenario, cache_dir=tmp_path, backend=backend)
    (segment,) = sequence.segments
    assert (segment.first_frame, segment.last_frame) == (4, 11)
    np.testing.assert_array_equal(sequence.frames[6], 255 - plain.frames[6])
    np.testing.assert_array_equal(sequence.frames[2], plain.frames[2])
    assert digest(sequence) == digest(sim.render(scenario, cache_dir=tmp_path / "other", backend=backend))


def test_a_degradation_of_ones_own_acts_on_recordings(inverted, tmp_path, dslab):
    frames = [np.full((48, 64), 10 * k, np.uint8) for k in range(10)]
    camera = sim.Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, 10.0)
    recorded = sim.Sequence("own", camera, np.arange(10) / 10, frames, None, None, (), {})
    segment = scenarios.parse_segment("inverted:start_s=0.2,duration_s=0.3,share=1")
    degraded = sim.degrade(recorded, [segment], 0, tmp_path)
    assert [int(degraded.frames[k][0, 0]) for k in (1, 2, 4, 5)] == [10, 235, 215, 50]
    assert (degraded.segments[0].first_frame, degraded.segments[0].last_frame) == (2, 4)
    assert "inverted" in dslab("degrade", "--list")[1]


def test_specs_know_the_kind_and_its_faults_are_named(inverted):
    assert "Inverted" in json_schema()["$defs"]
    segment = scenarios.parse_segment("inverted:start_s=1,duration_s=1,share=0.5")
    assert isinstance(segment, Inverted)
    with pytest.raises(scenarios.InputError, match="did you mean"):
        scenarios.parse_segment("invertd:start_s=1,duration_s=1,share=0.5")


def test_the_sources_of_an_extension_are_part_of_the_cache_key(inverted):
    assert sources()["degradation: inverted"] == extension_digests()["degradation: inverted"]


@pytest.mark.parametrize(
    ("model", "degradation", "said"),
    [
        (Inverted, registry.DEGRADATIONS["motion_blur"], "go together"),
        (scenarios.SegmentBase, registry.DEGRADATIONS["motion_blur"], "kind"),
        (type(scenarios.parse_segment("jpeg:start_s=0,duration_s=1,quality=5")), Inversion(), "is of kind"),
    ],
)
def test_what_does_not_fit_is_refused(model, degradation, said):
    with pytest.raises(ValueError, match=said):
        sim.register_degradation(model, degradation)


def test_a_degradation_without_a_name_of_its_measure_is_refused(monkeypatch):
    monkeypatch.delattr(Inversion, "measure_name")
    with pytest.raises(ValueError, match="Inversion has no measure_name"):
        sim.register_degradation(Inverted, Inversion())


def test_a_kind_that_is_taken_is_refused(inverted):
    class Another(scenarios.ImageSegment):
        kind: Literal["inverted"]

    with pytest.raises(ValueError, match="already"):
        sim.register_degradation(Another, Inversion())


def test_a_world_and_a_motion_of_ones_own_are_rendered(tmp_path):
    def as_room(spec):
        return room.RoomWorld(length_m=spec.size_m, width_m=spec.size_m - 1)

    sim.register_world(
        Shed,
        lambda spec, seed: room.layout(as_room(spec), seed),
        lambda spec, seed: room.build_world(as_room(spec), seed),
    )
    sim.register_motion("stroll", plan_walk, defaults={"max_speed_mps": 0.4})
    try:
        small = small_scenario("room").model_dump()
        own = {"world": {"kind": "shed"}, "trajectory": {"kind": "stroll"}}
        scenario = scenarios.Scenario.model_validate(small | own)
        assert scenario.world.kind == "shed" and scenario.trajectory.max_speed_mps == 0.4
        sequence = sim.render(scenario, cache_dir=tmp_path, backend=small_backend())
        steps = np.linalg.norm(np.diff(sequence.T_world_cam[:, :3, 3], axis=0), axis=1)
        assert 0 < steps.max() * scenario.camera.fps < 0.6
        with pytest.raises(ValueError, match="already"):
            sim.register_motion("stroll", plan_motion)
        with pytest.raises(ValueError, match="no field 'wings'"):
            sim.register_motion("fly", plan_walk, defaults={"wings": 2})
    finally:
        WORLD_KINDS.remove("shed")
        del WORLDS["shed"], _PLANS["stroll"], motions.KINDS["stroll"], motions._OF_KIND["stroll"]
