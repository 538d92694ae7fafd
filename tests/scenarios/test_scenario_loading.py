"""Scenario files: accepted content, and one line with file, field and remedy per fault."""

from pathlib import Path

import numpy as np
import pytest

from dslab.scenarios.errors import InputError
from dslab.scenarios.families import family_names
from dslab.scenarios.loading import dump_yaml, load_scenario
from dslab.scenarios.spec import Camera, FastRotation, LowTexture, MotionBlur, RoomWorld, Scenario

VALID = """\
name: trial
duration_s: 20
world: {kind: room}
segments:
  - {kind: low_texture, start_s: 4, duration_s: 2, contrast: 0.1}
  - {kind: motion_blur, start_s: 8, duration_s: 1, exposure_s: 0.05}
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "trial.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def fault(folder: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        load_scenario(write(folder, text))
    line = str(caught.value)
    assert "\n" not in line
    assert "trial.yaml" in line
    return line


def test_a_valid_file_gives_its_values_and_the_defaults(tmp_path):
    scenario = load_scenario(write(tmp_path, VALID))
    assert scenario.segments[0] == LowTexture(kind="low_texture", start_s=4, duration_s=2, contrast=0.1)
    assert scenario.segments[1].end_s == 9
    assert scenario.segments[1].severity == {"exposure_s": 0.05}
    assert scenario.camera == Camera()
    assert scenario.frame_count == 600


def test_the_three_named_scenarios_are_30_s_of_vga_video():
    assert {"clean-room", "clean-corridor", "stressed"} <= set(family_names())
    for name in ("clean-room", "clean-corridor", "stressed"):
        scenario = load_scenario(name)
        assert (scenario.duration_s, scenario.camera.fps) == (30, 30)
        assert (scenario.camera.width_px, scenario.camera.height_px) == (640, 480)
    kinds = [segment.kind for segment in load_scenario("stressed").segments]
    assert kinds == ["low_texture", "motion_blur", "fast_rotation"]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("contrast", "contrats", ["trial.yaml:5: segments[0].contrats", "unknown key", "contrast (did you"]),
        ("kind: low_texture", "kind: low_textur", [":5: segments[0].kind", "'low_textur'", "motion_blur"]),
        ("{kind: room}", "{}", ["world.kind", "is missing", "room, corridor"]),
        ("duration_s: 20", "duration_s: -20", [":2: duration_s", "-20", "greater than 0"]),
        ("duration_s: 20", "duration_s: .nan", [":2: duration_s", "finite"]),
        (
            "motion_blur, start_s: 8, duration_s: 1, exposure_s: 0.05",
            "low_texture, start_s: 5, duration_s: 1, contrast: 0.5",
            ["segments[1]: low_texture, 5-6 s", "segments[0] (low_texture, 4-6 s)", "one kind"],
        ),
        ("start_s: 8", "start_s: 19.5", ["segments[1]", "ends after the sequence", "duration_s = 20"]),
        ("{kind: room}", "{kind: room}\ncamera: {cx_px: 640}", [":4: camera", "cx_px = 640", "0 to 639"]),
        (
            "{kind: room}",
            "{kind: room}\ncamera: {exposure_s: 0.1}",
            ["exposure_s = 0.1", "longer than a frame"],
        ),
        ("duration_s: 20", "duration_s: 20\nduration_s: 30", [":3: duration_s", "twice"]),
        (VALID, "- 1\n", ["holds no scenario"]),
        (VALID, "seed: 2024-13-45\n", [":1: seed", "'2024-13-45'"]),
    ],
)
def test_each_fault_names_file_field_and_remedy(tmp_path, old, new, expected):
    assert old in VALID
    line = fault(tmp_path, VALID.replace(old, new, 1))
    for part in expected:
        assert part in line


def test_a_misspelt_key_is_named_before_the_key_that_is_missing_for_it(tmp_path):
    line = fault(tmp_path, VALID.replace("contrast:", "contrst:"))
    assert "unknown key" in line
    assert "1 more" in line


def test_segments_that_touch_do_not_overlap(tmp_path):
    scenario = load_scenario(write(tmp_path, VALID.replace("start_s: 8", "start_s: 6")))
    assert scenario.segments[0].end_s == scenario.segments[1].start_s


def test_overlap_is_found_whatever_the_order_in_the_file():
    late = MotionBlur(kind="motion_blur", start_s=5, duration_s=2, exposure_s=0.1)
    early = MotionBlur(kind="motion_blur", start_s=1, duration_s=5, exposure_s=0.2)
    with pytest.raises(ValueError, match=r"segments.0\s.*segments\[1\].*overlap"):
        Scenario(name="x", world=RoomWorld(), segments=(late, early))


def test_segments_of_different_kinds_may_lie_over_one_another():
    swing = FastRotation(kind="fast_rotation", start_s=5, duration_s=2, rate_degps=90)
    blur = MotionBlur(kind="motion_blur", start_s=5, duration_s=2, exposure_s=0.1)
    assert Scenario(name="x", world=RoomWorld(), segments=(swing, blur)).segments == (swing, blur)


def test_the_sensor_starts_from_its_preset(tmp_path):
    assert load_scenario(write(tmp_path, VALID)).imu is None
    scenario = load_scenario(write(tmp_path, VALID + "imu: {preset: realsense, rate_hz: 400}\n"))
    assert scenario.imu is not None
    assert (scenario.imu.rate_hz, scenario.imu.gyro_noise) == (400, 1e-3)
    assert load_scenario(write(tmp_path, dump_yaml(scenario))) == scenario
    assert "imu.gyro_nois" in fault(tmp_path, VALID + "imu: {gyro_nois: 1}\n")


def test_an_unknown_name_lists_the_names():
    with pytest.raises(InputError, match=r"stressed \(did you mean that\?\).*clean-corridor, clean-room"):
        load_scenario("stresed")


@pytest.mark.parametrize("path", ["missing.yaml", "."])
def test_a_path_that_is_no_file_is_refused(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError):
        load_scenario(path)


def test_binary_content_is_refused(tmp_path):
    path = tmp_path / "trial.yaml"
    path.write_bytes(np.arange(128, 256, dtype=np.uint8).tobytes())
    with pytest.raises(InputError, match="UTF-8"):
        load_scenario(path)


def test_a_segment_without_duration_lasts_to_the_end_of_the_sequence(tmp_path):
    text = VALID.replace("start_s: 8, duration_s: 1, ", "start_s: 8, ")
    assert load_scenario(write(tmp_path, text)).segments[1].end_s == 20
    assert load_scenario(write(tmp_path, text.replace("20", "12"))).segments[1].duration_s == 4
    assert "ends after the sequence" in fault(tmp_path, text.replace("start_s: 8", "start_s: 21"))
    assert "'soon' is not valid" in fault(tmp_path, text.replace("start_s: 8", "start_s: soon"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"duration_s": 4.0}, r"Scenario.segments.0: .*ends after the sequence"),
        ({"duraton_s": 4.0}, "Scenario.duraton_s: unknown key; use duration_s"),
        ({"seed": -1}, "Scenario.seed: -1 is not valid"),
    ],
)
def test_a_copy_with_other_fields_is_checked(changes, said):
    scenario = load_scenario("stressed")
    with pytest.raises(InputError, match=said):
        scenario.model_copy(update=changes)
    copy = scenario.model_copy(update={"duration_s": 40.0})
    assert copy.duration_s == 40 and copy.segments == scenario.segments
    assert copy.model_fields_set == scenario.model_fields_set | {"duration_s"}
