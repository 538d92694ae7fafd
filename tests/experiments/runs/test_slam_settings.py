"""Settings from files: all described, nothing unknown accepted, a summary's own block accepted back."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from dslab.experiments.runs.files import to_json
from dslab.experiments.runs.slam_settings import (
    factory_of,
    fields_of,
    read_slam_settings,
    settings_yaml,
    unit_and_range,
)
from dslab.scenarios.errors import InputError
from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.paper import PAPER, paper_config
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.registry import ThreadSpec
from dslab.slam.factory import build_system
from dslab.slam.ldso.config import DsoConfig, WindowConfig
from dslab.slam.tracking.config import TrackingConfig

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0)
KITTI = PinholeCamera(1241, 376, 718.0, 718.0, 607.0, 185.0, 10.0)


def read(tmp_path, text):
    path = tmp_path / "slam.yaml"
    path.write_text(text)
    return read_slam_settings(path)


def test_what_is_shown_is_the_defaults_and_valid(tmp_path):
    settings = read(tmp_path, settings_yaml())
    assert settings.of("dual", CAMERA) == (SlamConfig(), DualConfig())


def test_every_field_is_described():
    lines = settings_yaml().splitlines()
    named = [k for k, line in enumerate(lines) if line and not line.lstrip().startswith("#")]
    assert len(named) > 200
    assert [lines[k] for k in named if not re.match(r" *# \w", lines[k - 1])] == []


def test_the_page_of_settings_says_what_the_code_has():
    page = Path(__file__).parents[3] / "docs" / "settings.md"
    rows = re.findall(r"^\| `([\w.]+)` \| (.*?) \| (.*?) ?\|", page.read_text(), re.MULTILINE)
    assert len(rows) == 23
    for path, default, span in rows:
        value = {"dual": DualConfig(), "dso": DsoConfig()}.get(path.split(".")[0], SlamConfig())
        field = {}
        for step in path.removeprefix("dual.").removeprefix("dso.").split("."):
            field, value = fields_of(type(value))[step], getattr(value, step)
        value = [thread.kind for thread in value] if isinstance(value, tuple) else value
        shown = yaml.safe_load(yaml.safe_dump(value))
        assert (default, span) == (str(shown).replace("'", ""), unit_and_range(field)), path


def test_what_a_file_leaves_out_keeps_the_defaults_of_the_image_size(tmp_path):
    settings = read(tmp_path, "tracking: {local_map_keyframes: 40}\n")
    (wide, dual), (usual, _) = (settings.of("dual", camera) for camera in (KITTI, CAMERA))
    assert wide.orb.n_features == 2000 and usual.orb.n_features == 1000
    assert wide.tracking.local_map_keyframes == 40 and dual == DualConfig()


def test_what_a_file_leaves_out_keeps_what_the_system_has_by_itself(tmp_path):
    settings = read(tmp_path, "tracking: {local_map_keyframes: 40}\ndual: {workers: 3, place_merging: {}}\n")
    config, dual = settings.of("paper+", CAMERA)
    published = paper_config(CAMERA, plus=True)
    assert config == replace(published, tracking=replace(published.tracking, local_map_keyframes=40))
    assert dual == replace(PAPER, workers=3, place_merging=FusionConfig())
    assert replace(settings, dual_options={"workers": 2}).of("paper", CAMERA)[1].workers == 2


@pytest.mark.parametrize("kind", ["base", "dual+", "paper"])
def test_the_block_of_a_summary_is_accepted_back(tmp_path, kind):
    threads = (ThreadSpec("orb", 0, RecoveryConfig(max_unusable_s=math.inf)), ThreadSpec("sift", 1))
    config = replace(SlamConfig(), min_map_keyframes=7)
    dual = DualConfig(recovery_threads=threads, place_merging=None)
    system = build_system(kind, CAMERA, config=config, dual=dual)
    again = read(tmp_path, to_json({"sequence": "x", "config": system.settings}))
    assert again.of(kind, CAMERA) == (system.config, DualConfig() if kind == "base" else dual)
    assert again.mode == "lockstep"
    assert factory_of(again)(kind, CAMERA, 0).settings == system.settings


def test_a_thread_is_as_the_system_except_for_what_its_own_settings_say(tmp_path):
    text = """
        tracking: {local_map_keyframes: 40}
        dual:
          recovery_threads: [orb, {kind: gms, config: {tracking: {max_uncertainty: 0.1}, min_inliers: 25}}]
    """
    orb, gms = read(tmp_path, text).of("dual", CAMERA)[1].recovery_threads
    assert orb.config is None and gms.config.mapping is None and gms.config.min_inliers == 25
    assert gms.config.tracking == TrackingConfig(local_map_keyframes=40, max_uncertainty=0.1)


@pytest.mark.parametrize(
    ("text", "where", "said"),
    [
        ("orb:\n  n_feature: 3\n", ":2: orb.n_feature", "n_features (did you mean that?)"),
        ("orb: 3\n", ":1: orb", "is no mapping"),
        ("tracking: {local_map_keyframes: many}\n", ":1: tracking.local_map_keyframes", "valid integer"),
        ("orb: {n_features: 0}\n", ":1: orb.n_features", "equal to 1"),
        ("orb: {scale_factor: 1}\n", ":1: orb.scale_factor", "greater than 1"),
        (
            "tracking:\n  keyframe_information: 1.5\n",
            ":2: tracking.keyframe_information",
            "less than or equal to 1",
        ),
        ("self_calibration: {at_keyframes: [3, -1]}\n", ":1: self_calibration.at_keyframes[1]", "equal to 0"),
        ("orb: {n_features: 2000000}\n", ":1: orb.n_features", "less than or equal to 1000000"),
        (
            "dual: {recovery_threads: [orb, sfit]}\n",
            ":1: dual.recovery_threads[1].kind",
            "sift (did you mean that?)",
        ),
        (
            "dual:\n  recovery_threads:\n  - kind: sift\n    config: {contrst: 1}\n",
            ":4: ",
            "contrast (did you mean",
        ),
        (
            "dual: {recovery_threads: [{kind: orb, config: {tracking: {uncertainty: 1}}}]}\n",
            ":1: ",
            "max_uncertainty",
        ),
        ("dual: {threads: [orb]}\n", ":1: dual.threads", "use recovery_threads"),
        ("mode: fast\n", ":1: mode", "'lockstep' or 'threaded'"),
    ],
)
def test_a_fault_is_one_line_with_its_place(tmp_path, text, where, said):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert where in str(caught.value) and said in str(caught.value)


def test_the_command_takes_the_settings(dslab, tmp_path):
    assert dslab("config", "show") == (0, settings_yaml(), "")
    (tmp_path / "bad.yaml").write_text("orbs: {}\n")
    code, _, err = dslab("run", "clean-room", "--config", tmp_path / "bad.yaml", "--out", tmp_path / "o")
    assert code == 2 and "orbs: unknown key" in err and not (tmp_path / "o").exists()


@pytest.mark.parametrize("kind", ["dso", "ldso"])
def test_settings_reach_direct_sparse_odometry(tmp_path, kind):
    text = "loops: {min_gap: 7}\ndso: {window: {points: 900}, selection: {points: 700}}\n"
    system = factory_of(read(tmp_path, text))(kind, CAMERA, 0)
    assert system.config.loops.min_gap == 7
    assert system.dso.window.points == 900 and system.dso.selection.points == 700
    assert system.dso.window.most == WindowConfig().most
    again = read(tmp_path, to_json({"sequence": "x", "config": system.settings}))
    assert factory_of(again)(kind, CAMERA, 0).settings == system.settings
