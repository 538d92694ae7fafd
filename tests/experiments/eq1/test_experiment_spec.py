"""Experiment specs: cells, units, common seeds, and every fault in one line."""

import jsonschema
import pytest
import yaml

from dslab.experiments.eq1.spec import ExperimentSpec, load_spec, preset_names
from dslab.experiments.eq1.spec_schema import json_schema
from dslab.experiments.eq1.units import UnitSpec, unit_settings
from dslab.scenarios.errors import InputError
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.tracking.config import TrackingConfig

VALIDATOR = jsonschema.Draft202012Validator(json_schema())
SPEC = """\
name: two
root_seed: 5
bases:
  passage:
    world: {kind: corridor, length_m: {uniform: [30, 60]}, turns: {uniform: [0, 3]}}
    trajectory: {max_speed_mps: {uniform: [0.5, 1.5]}, gaze_deg: {choice: [0, 90]}}
  hall:
    family: clean-room
    camera: {fps: 15}
degradations:
  - kind: motion_blur
    dose: exposure_s
    doses: [0.1, 0.2]
    begins_s: {uniform: [0, 1]}
    acts_s: 0.7
  - kind: fast_rotation
    dose: rate_degps
    doses: {passage: [60, 90], hall: [120]}
    severities: {passage: [1, 2], hall: [1]}
    fields: {axis: yaw}
systems: [dual, dual+]
threads: [orb, {kind: orb, seed: 1}, sift]
lead_in_s: 4
exposed_s: 3
tail_s: 5
worlds: 2
sequences_per_world: 2
repeats: 3
confirmatory: [passage/motion_blur/1/dual]
"""


@pytest.fixture
def spec(tmp_path) -> ExperimentSpec:
    return load(tmp_path, SPEC)


def load(folder, text: str) -> ExperimentSpec:
    path = folder / "spec.yaml"
    path.write_text(text)
    return load_spec(path)


def test_cells_are_every_combination_by_name(spec):
    images = ["motion_blur/1", "motion_blur/2", "fast_rotation/1", "fast_rotation/2", "sham"]
    expected = [f"{b}/{i}/{s}" for b in ("passage", "hall") for i in images for s in ("dual", "dual+")]
    assert spec.cell_names() == [name for name in expected if "hall/fast_rotation/2" not in name]
    assert {spec.units_of(cell) for cell in spec.cell_names()} == {12}


def test_a_degradation_acts_in_the_bases_that_have_doses(tmp_path):
    text = SPEC.replace("doses: [0.1, 0.2]", "doses: {passage: [0.1]}")
    cells = load(tmp_path, text).cell_names()
    assert [cell for cell in cells if "motion_blur" in cell] == [
        f"passage/motion_blur/1/{s}" for s in ("dual", "dual+")
    ]
    nowhere = text.replace(", hall: [120]}", "}").replace(", hall: [1]}", "}")
    with pytest.raises(InputError, match="bases: no degradation has a dose for hall"):
        load(tmp_path, nowhere)


def test_settings_reach_every_unit_and_its_threads(tmp_path):
    given = "settings: {tracking: {local_map_keyframes: 40}, dual: {workers: 1}}\nworlds: 2"
    text = SPEC.replace("worlds: 2", given).replace(
        "seed: 1}", "seed: 1, config: {tracking: {keyframe_interval_s: 0.2}}}"
    )
    unit = load(tmp_path, text).unit("hall/motion_blur/1/dual", 0)
    unit = UnitSpec.model_validate(unit.model_dump(mode="json"))
    settings = unit_settings(unit.settings, unit.threads)
    _, dual = settings.of("dual", PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0))
    assert dual.workers == 1 and dual.exhaustive and not dual.relocalization
    assert settings.written == {"tracking": {"local_map_keyframes": 40}}
    plain, own, _ = dual.recovery_threads
    assert plain.config is None
    assert own.config.tracking == TrackingConfig(local_map_keyframes=40, keyframe_interval_s=0.2)


def test_a_unit_contains_everything_that_determines_it(spec):
    unit = spec.unit("passage/motion_blur/2/dual+", 6)
    assert (unit.kind, unit.severity, unit.index, unit.system) == ("motion_blur", 0.2, 6, "dual+")
    assert [(t.kind, t.seed) for t in unit.threads] == [("orb", 0), ("orb", 1), ("sift", 0)]
    assert (unit.onset_s, unit.exposed_s, unit.scenario.duration_s) == (4, 3, 12)
    (segment,) = unit.scenario.segments
    assert 4 <= segment.start_s <= 5 and segment.duration_s == 0.7 and segment.exposure_s == 0.2
    seeds = (unit.scenario.seed, unit.scenario.world_seed, unit.scenario.noise_seed)
    assert seeds == (unit.sequence_seed, unit.world_seed, unit.repeat_seed)
    assert (unit.base, unit.sequence, unit.repeat) == ("passage", 0, 0)
    assert isinstance(unit.scenario.world.turns, int)
    assert spec.unit("passage/fast_rotation/1/dual", 0).severity == 1
    last = spec.unit("passage/fast_rotation/1/dual", 0).scenario.segments[0]
    assert (last.start_s, last.end_s) == (4, 7)  # it acts for all of the exposed segment
    assert spec.unit("hall/motion_blur/1/dual", 0).scenario.world.kind == "room"
    assert spec.unit("hall/motion_blur/1/dual", 0).scenario.camera.fps == 15
    rates = [
        spec.unit(f"{c}/dual", 0).scenario.segments[0].rate_degps
        for c in ("passage/fast_rotation/2", "hall/fast_rotation/1")
    ]
    assert rates == [90, 120]


def test_a_sham_has_the_same_lead_in_and_no_stress(spec):
    sham, stressed = (spec.unit(f"passage/{cell}/dual", 3) for cell in ("sham", "motion_blur/2"))
    assert (sham.kind, sham.severity, sham.scenario.segments) == ("sham", 0.0, ())
    same = ("world_seed", "sequence_seed", "repeat_seed", "start_frame", "onset_s")
    assert [getattr(sham, name) for name in same] == [getattr(stressed, name) for name in same]


def test_creeping_stress_is_a_kind_of_its_own_that_rises_over_its_duration(tmp_path):
    creeping = "  - {kind: defocus, creeping: true, dose: diameter_px, doses: [8], acts_s: 2}\nsystems:"
    spec = load(tmp_path, SPEC.replace("systems:", creeping))
    unit = spec.unit("hall/defocus-creeping/1/dual", 0)
    (segment,) = unit.scenario.segments
    assert unit.kind == "defocus-creeping"
    assert (segment.duration_s, segment.ramp_s, segment.falls_s) == (2, 2, 0)


def test_a_copy_with_other_fields_has_the_cells_of_these(spec):
    assert len(spec.cells) > 1
    one = spec.model_copy(
        update={"bases": {"hall": spec.bases["hall"]}, "degradations": spec.degradations[:1], "sham": False}
    )
    assert one.cell_names() == [f"motion_blur/{dose}/{s}" for dose in (1, 2) for s in ("dual", "dual+")]


def test_an_index_means_the_same_world_path_and_noise_in_every_cell(spec):
    for index in (0, 3, 9):
        units = [spec.unit(cell, index) for cell in spec.cell_names() if cell.startswith("passage")]
        for part in ("world", "trajectory", "camera", "seed", "world_seed"):
            assert len({str(getattr(u.scenario, part)) for u in units}) == 1, part
        assert len({(u.sequence, u.repeat, u.repeat_seed, u.start_frame) for u in units}) == 1
        blurred = [u.scenario.segments[0] for u in units if u.kind == "motion_blur"]
        assert len({(s.start_s, s.duration_s) for s in blurred}) == 1


def test_units_are_replicates_of_sequences_in_worlds(spec):
    units = [spec.unit("passage/motion_blur/1/dual", i) for i in range(spec.units)]
    assert [(u.sequence, u.repeat) for u in units] == [(s, k) for s in (0, 1) for k in range(3)] * 2
    by = {name: [getattr(u, f"{name}_seed") for u in units] for name in ("world", "sequence", "repeat")}
    assert [len(set(seeds)) for seeds in by.values()] == [2, 4, 12]
    assert by["world"] == sorted(by["world"], key=by["world"].index)
    first, other = units[:3], units[3:6]
    # Replicates share path and stress; they differ in noise, start and the seeds of the systems.
    for name in ("trajectory", "segments", "camera", "seed"):
        assert len({str(getattr(u.scenario, name)) for u in first}) == 1
    assert str(first[0].scenario.world) == str(other[0].scenario.world)
    assert first[0].scenario.trajectory != other[0].scenario.trajectory
    starts = {spec.unit("passage/motion_blur/1/dual", i).start_frame for i in range(200)}
    assert starts == set(range(30))  # within the first second
    assert len({u.unit_id for u in units}) == 12


def test_without_repeats_noise_is_of_the_sequence(tmp_path):
    once = load(tmp_path, SPEC.replace("repeats: 3", "repeats: 1"))
    assert once.unit("passage/sham/dual", 0).scenario.noise_seed is None


def test_a_unit_does_not_depend_on_other_units_and_cells(spec, tmp_path):
    alone = yaml.safe_load(SPEC)
    alone["degradations"] = alone["degradations"][1:]
    alone |= {"worlds": 100, "description": "more of them", "confirmatory": []}
    other = load(tmp_path, yaml.safe_dump(alone))
    cell = "passage/fast_rotation/1/dual"
    assert other.unit(cell, 3) == spec.unit(cell, 3)


def test_the_hash_covers_everything_that_determines_units(spec):
    def changed(**fields):
        return spec.model_validate({**spec.model_dump(), **fields}).content_hash

    assert changed(worlds=99, description="x") == spec.content_hash
    for fields in (
        {"root_seed": 6},
        {"tail_s": 6},
        {"threads": ("orb",)},
        {"repeats": 4},
        {"confirmatory": ()},
    ):
        assert changed(**fields) != spec.content_hash


def test_the_written_spec_reads_back(spec, tmp_path):
    again = load(tmp_path, spec.as_yaml())
    assert again == spec and again.content_hash == spec.content_hash
    assert again.unit("hall/motion_blur/2/dual", 1) == spec.unit("hall/motion_blur/2/dual", 1)


def test_a_family_may_be_used_by_member_or_as_a_whole(tmp_path):
    text = SPEC.replace("family: clean-room\n    camera: {fps: 15}", "{family: small, each_member: true}")
    text = text.replace("hall:\n    {", "hall: {")
    spec = load(tmp_path, text)
    assert "hall-warehouse/motion_blur/1/dual" in spec.cell_names()
    assert spec.unit("hall-warehouse/motion_blur/1/dual", 0).scenario.world.kind == "warehouse"
    with pytest.raises(
        InputError, match=r":7: bases.hall.family: mixes worlds of kinds .* set each_member: true"
    ):
        load(tmp_path, text.replace(", each_member: true", ""))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("worlds: 2", "worldz: 2", ":26: worldz: unknown key; use worlds (did you mean that?)"),
        (
            "world: {kind: corridor, length_m: {uniform: [30, 60]}, turns: {uniform: [0, 3]}}",
            "world: {choice: [{kind: corridor}, {kind: room}]}",
            ":5: bases.passage.world: mixes worlds of kinds corridor and room in one cell; give each a base",
        ),
        (
            "trajectory: {max",
            "trajectory: {kind: {choice: [handheld, car]}, max",
            ":6: bases.passage.trajectory: mixes motions of kinds car and handheld in one cell",
        ),
        (
            "axis: yaw",
            "axis: {choice: [yaw, pitch]}",
            ":20: degradations[1].fields.axis: mixes yaw and pitch",
        ),
        (
            "hall: [120]}",
            "hal: [120]}",
            "fast_rotation: doses: hal is no base; use passage or hall",
        ),
        ("hall: [1]}", "hall: [1, 2]}", "fast_rotation: 2 severities for 1 doses"),
        ("dual]\n", "dual]\nconfirmatory_threads: 4\n", "confirmatory_threads is 4 of 3 threads"),
        ("repeats: 3", "repeats: 3\nlevels: [sequences]", "repeats is 3, but chance within sequences with 3"),
        ("repeats: 3", "repeats: 4\nlevels: [worlds]", "give sequences_per_world: 4 or leave worlds out"),
        ("blur/1/dual]", "blur/3/dual]", ":29: confirmatory[0]: passage/motion_blur/3/dual is no cell"),
        ("blur/1/dual]", "blur/1/dual, hall/sham/dual]", "hall/sham/dual is no cell with a dose"),
        (
            "kind: fast_rotation\n",
            "kind: fast_rotation\n    creeping: true\n",
            "creeping: fast_rotation has no ramp_s; use a kind that acts on images",
        ),
        ("kind: motion_blur", "kind: motion_blurr", ":11: degradations[0].kind: unknown kind 'motion_blurr'"),
        (
            "dose: exposure_s",
            "dose: exposure",
            ":11: degradations[0]: dose: a segment of kind motion_blur has no",
        ),
        ("doses: [0.1, 0.2]", "doses: [0.1, 2]", ":13: degradations[0].doses[1]: 2.0 is not valid"),
        ("doses: [0.1, 0.2]", "doses: [0.1, 0.1]", "degradations, motion_blur: two doses have the same"),
        ("axis: yaw", "axis: up", ":20: degradations[1].fields.axis: 'up' is not valid"),
        ("length_m: {uniform: [30, 60]}", "length_m: 3", ":5: bases.passage.world.length_m: 3 is not valid"),
        ("{uniform: [30, 60]}", "{uniform: [30]}", ":5: bases.passage.world.length_m: uniform [30] has no"),
        (
            "begins_s: {uniform: [0, 1]}",
            "begins_s: soon",
            ":14: degradations[0].begins_s: 'soon' is",
        ),
        ("begins_s: {uniform: [0, 1]}", "begins_s: 3", ":15: degradations[0].acts_s: 0.0 is not valid"),
        (
            "threads: [orb,",
            "threads: [gps,",
            "unknown recovery thread 'gps'; use direct or gms or orb or paper_orb or paper_sift or sift",
        ),
        ("{kind: orb, seed: 1}", "orb", "two threads are the same; give those of one kind different seeds"),
        ("seed: 1}", "seed: 1, config: {min_shar: 0}}", ":22: threads[1].config.min_shar: unknown key"),
        (
            "worlds: 2",
            "worlds: 2\nsettings: {orb: {n_feature: 1}}",
            ":27: settings.orb.n_feature: unknown key; use n_features",
        ),
        (
            "worlds: 2",
            "worlds: 2\nsettings: {dual: {exhaustive: false}}",
            ":27: settings.dual.exhaustive: is set by",
        ),
        ("family: clean-room", "family: clean-rome", ":7: bases.hall: there is no family clean-rome"),
        ("systems: [dual, dual+]", "systems: [dual, a:Own, b:Own]", "systems names Own twice"),
        ("systems: [dual, dual+]", "systems: [dual, dso]\narms: [crossing]", "dso has no recovery threads"),
        ("blur/1/dual]", "blur/1/dso]", "blur/1/dso is no cell with a dose and recovery threads"),
        ("repeats: 3", "repeats: 0", ":28: repeats: 0 is not valid"),
    ],
)
def test_every_fault_is_one_line_with_file_and_field(tmp_path, old, new, told):
    assert old in SPEC
    with pytest.raises(InputError) as caught:
        load(tmp_path, SPEC.replace(old, new, 1))
    line = str(caught.value)
    assert "\n" not in line and line.startswith(str(tmp_path / "spec.yaml")) and told in line


def test_a_similar_name_is_suggested_for_an_unknown_one(spec):
    with pytest.raises(InputError, match=r"no such experiment; use smoke \(did you mean"):
        load_spec("smok")
    with pytest.raises(InputError, match="no such cell; use hall/motion_blur/1/dual"):
        spec.unit("hall/motion_blur/1", 0)


@pytest.mark.parametrize("name", preset_names())
def test_presets_are_valid_and_described(name):
    spec = load_spec(name)
    assert spec.name == name and spec.description
    text = (load_spec.__globals__["PRESET_DIR"] / f"{name}.yaml").read_text()
    VALIDATOR.validate(yaml.safe_load(text))


def test_the_presets_are_all_there():
    wanted = {"smoke", "eq1", "eq1-full", "direction", "loss-rule", "tables"}
    assert wanted <= set(preset_names())


@pytest.mark.slow
def test_the_schema_refuses_what_the_loader_refuses():
    jsonschema.Draft202012Validator.check_schema(json_schema())
    VALIDATOR.validate(yaml.safe_load(SPEC))
    for old, new in (("worlds: 2", "worldz: 2"), ("length_m: {uniform: [30, 60]}", "length_m: 3"),
                     ("kind: motion_blur", "kind: mud"), ("begins_s: {uniform: [0, 1]}", "begins_s: soon"),
                     ("threads: [orb,", "threads: [gps,")):  # fmt: skip
        assert not VALIDATOR.is_valid(yaml.safe_load(SPEC.replace(old, new, 1)))


def test_a_system_without_recovery_threads_has_cells_of_its_own_in_the_free_arm(tmp_path):
    spec = load(tmp_path, SPEC.replace("[dual, dual+]", '[dual, "own/slam.py:Own"]'))
    unit = spec.unit("passage/motion_blur/1/Own", 3)
    assert (unit.system, unit.arms, unit.recovers) == ("own/slam.py:Own", ("free",), False)
    beside = spec.unit("passage/motion_blur/1/dual", 3)
    assert beside.arms == ("free", "crossing")
    frames = ("scenario", "start_frame", "onset_s", "exposed_s", "repeat_seed")
    assert [getattr(unit, name) for name in frames] == [getattr(beside, name) for name in frames]
