"""Rendering a scenario: same bytes for the same seed, the cache, truth that fits the frames."""

import hashlib
import json
import logging
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_world import CAMERA, CORRIDOR

from dslab.scenarios.errors import InputError
from dslab.scenarios.spec import Scenario
from dslab.sim.io.forms import load_sequence
from dslab.sim.sequence_rendering import RenderBackend, render_backend, render_sequence
from dslab.sim.worlds.base import Route, Surface, WorldModel

SPEC = {
    "name": "trial",
    "duration_s": 4,
    "world": CORRIDOR,
    "trajectory": {"gaze_deg": 90},
    "camera": CAMERA,
    "segments": [
        {"kind": "low_texture", "start_s": 0.5, "duration_s": 1, "contrast": 0.1},
        {"kind": "motion_blur", "start_s": 2, "duration_s": 0.5, "exposure_s": 0.3},
        {"kind": "fast_rotation", "start_s": 3, "duration_s": 0.8, "rate_degps": 90},
    ],
}
SCENARIO = Scenario.model_validate(SPEC)


class FakeRenderer:
    """A wall 1 m to the left with a texture in vertical stripes; surface k is its k-th metre."""

    def __init__(self, world, camera) -> None:
        self._world, self._camera = world, camera

    def _metre(self, T_world_cam) -> np.ndarray:
        rays = (np.arange(self._camera.width_px) - self._camera.cx) / self._camera.fx
        directions = T_world_cam[:2, 2] + rays[:, None] * T_world_cam[:2, 0]
        reach = 1.0 / np.maximum(directions[:, 1], 0.05)
        return T_world_cam[0, 3] + reach * directions[:, 0]

    def render(self, T_world_cam):
        metre = self._metre(T_world_cam)
        contrast = self._world.contrast[np.clip(metre.astype(int), 0, 9)]
        line = 128 + contrast * 100 * np.sign(np.sin(40 * metre))
        shape = (self._camera.height_px, self._camera.width_px)
        return np.tile(line.astype(np.uint8), (shape[0], 1)), np.ones(shape, np.float32)

    def render_surface_ids(self, T_world_cam):
        metre = self._metre(T_world_cam)
        ids = np.where((metre >= 0) & (metre < 10), metre, -1).astype(np.int32)
        return np.tile(ids, (self._camera.height_px, 1))

    def close(self) -> None:
        pass


def fake_backend() -> RenderBackend:
    blank = Surface(
        np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), np.zeros((3, 2)), np.zeros((1, 1), np.uint8), ""
    )
    return RenderBackend(
        layout=lambda spec, seed: Route(np.array([[0.0, 0], [10, 0]]), 0.4, False),
        build_world=lambda spec, seed: WorldModel([blank] * 10, 128.0, np.ones(10)),
        renderer=FakeRenderer,
        gl_info=lambda: {"renderer": "fake"},
    )


def digest(sequence) -> str:
    return hashlib.sha256(b"".join(f.tobytes() for f in sequence.frames)).hexdigest()


@pytest.fixture
def rendered(tmp_path):
    return render_sequence(SCENARIO, 1, cache_dir=tmp_path / "cache", backend=fake_backend())


def test_frames_stamps_and_poses_are_complete(rendered):
    assert len(rendered) == len(rendered.frames) == 40
    np.testing.assert_allclose(rendered.stamps_s, np.arange(40) / 10)
    assert rendered.T_world_cam.shape == (40, 4, 4)
    assert rendered.frames[0].shape == (64, 96)
    assert rendered.meta["seed"] == 1
    assert rendered.meta["gl"] == {"renderer": "fake"}
    assert rendered.depths is None


def test_the_segments_are_where_the_scenario_places_them(rendered):
    low, blur, swing = rendered.segments
    assert 3 <= low.first_frame <= 10 and 10 <= low.last_frame <= 20
    assert (blur.first_frame, blur.last_frame) == (20, 24)
    assert 30 <= swing.first_frame < swing.last_frame <= 38
    truth = rendered.frame_truth
    assert set(truth) == {"exposure_s", "blur_px", "faded_share", "swing_degps"}
    assert all(values.shape == (40,) for values in truth.values())
    assert (truth["exposure_s"] == np.where((np.arange(40) >= 20) & (np.arange(40) < 25), 0.3, 0.004)).all()


def test_the_segments_act_on_the_frames(rendered):
    spread = np.array([float(frame.std()) for frame in rendered.frames])
    low, blur, _ = rendered.segments
    assert spread[low.first_frame : low.last_frame + 1].min() < 0.5 * spread[30]
    assert spread[blur.first_frame + 1] < 0.5 * spread[blur.last_frame + 2]


def test_the_frame_shows_the_true_pose_at_the_centre_of_its_exposure(rendered):
    calm = Scenario.model_validate({**SPEC, "segments": []})
    world = replace(fake_backend().build_world(None, 0), contrast=np.ones(10))
    sequence = render_sequence(
        calm, 1, cache_dir=Path(str(rendered.frames._stack.filename)).parents[1], backend=fake_backend()
    )
    for frame in (0, 17, 39):
        sharp, _ = FakeRenderer(world, sequence.camera).render(sequence.T_world_cam[frame])
        error = np.abs(sequence.frames[frame].astype(int) - sharp)
        assert np.median(error) <= 3


def test_a_second_call_takes_the_frames_from_the_cache(tmp_path, rendered):
    def forbidden(*_):
        raise AssertionError("rendered again")

    steps: list[str] = []
    again = render_sequence(
        SCENARIO, 1, cache_dir=tmp_path / "cache", backend=replace(fake_backend(), renderer=forbidden),
        progress=lambda step, done, total: steps.append(step),
    )  # fmt: skip
    assert digest(again) == digest(rendered)
    assert steps == []
    assert again.segments == rendered.segments


def test_seed_spec_and_depth_make_other_entries(tmp_path, rendered):
    options = {"cache_dir": tmp_path / "cache", "backend": fake_backend()}
    assert digest(render_sequence(SCENARIO, 2, **options)) != digest(rendered)
    quiet = Scenario.model_validate({**SPEC, "camera": {**CAMERA, "noise_sigma": 0}})
    assert digest(render_sequence(quiet, 1, **options)) != digest(rendered)
    deep = render_sequence(SCENARIO, 1, depth=True, **options)
    assert digest(deep) == digest(rendered)
    assert deep.depths is not None and deep.depths[3].dtype == np.float32
    assert len(list((tmp_path / "cache").iterdir())) == 4


def with_jpeg(quality: float) -> Scenario:
    jpeg = {"kind": "jpeg", "start_s": 1, "duration_s": 2, "quality": quality}
    drops = {"kind": "frame_drops", "start_s": 1, "duration_s": 1, "share": 0.5}
    return Scenario.model_validate({**SPEC, "segments": [*SPEC["segments"], jpeg, drops]})


def test_depth_is_kept_on_request_only_and_serves_both(tmp_path):
    options = {"cache_dir": tmp_path, "backend": fake_backend()}
    plain = render_sequence(with_jpeg(5), 1, **options)
    assert not list(tmp_path.glob("*/depth.npy"))
    # Two bytes per pixel: the frames, and those before the encoder.
    assert sum(f.stat().st_size for f in tmp_path.glob("*/gray.npy")) < 2.1 * 40 * 64 * 96
    deep = render_sequence(with_jpeg(5), 1, depth=True, **options)
    assert digest(deep) == digest(plain) and deep.depths is not None
    (with_depth,) = {path.parent for path in tmp_path.glob("*/depth.npy")}
    for entry in set(tmp_path.iterdir()) - {with_depth}:
        shutil.rmtree(entry)
    again = render_sequence(with_jpeg(5), 1, **options)
    assert digest(again) == digest(plain) and again.depths is None
    assert list(tmp_path.iterdir()) == [with_depth]


@pytest.mark.parametrize("noise_seed", [None, 5])
def test_the_first_seconds_alone_are_those_of_the_whole(tmp_path, noise_seed):
    segments = [
        *SPEC["segments"],
        {"kind": "time_jitter", "start_s": 0.2, "duration_s": 3.5, "sigma_s": 0.02},
        {"kind": "frame_drops", "start_s": 0.3, "duration_s": 1.5, "share": 0.4},
    ]
    scenario = Scenario.model_validate({**SPEC, "segments": segments, "noise_seed": noise_seed})
    whole = render_sequence(scenario, 1, cache_dir=tmp_path / "whole", backend=fake_backend()).first(1.9)
    begun = render_sequence(scenario, 1, cache_dir=tmp_path / "begun", backend=fake_backend(), first_s=1.9)

    assert 10 < len(begun) < 19
    assert digest(begun) == digest(whole)
    np.testing.assert_array_equal(begun.stamps_s, whole.stamps_s)
    np.testing.assert_array_equal(begun.T_world_cam, whole.T_world_cam)
    assert set(begun.frame_truth) == set(whole.frame_truth)
    for name, column in whole.frame_truth.items():
        np.testing.assert_array_equal(begun.frame_truth[name], column, name)
    ranges = [[(s.first_frame, s.last_frame) for s in sequence.segments] for sequence in (begun, whole)]
    assert ranges[0] == ranges[1]
    kept = [min(f.stat().st_size for f in tmp_path.glob(f"{of}/*/gray.npy")) for of in ("begun", "whole")]
    assert kept[0] < kept[1] / 2


def test_the_first_seconds_of_a_cached_whole_are_not_rendered_again(tmp_path, rendered):
    idle = replace(fake_backend(), renderer=None)
    begun = render_sequence(SCENARIO, 1, cache_dir=tmp_path / "cache", backend=idle, first_s=2.0)
    assert len(begun) == 20


def test_another_severity_behind_the_lens_renders_nothing_again(tmp_path):
    def forbidden(*_):
        raise AssertionError("rendered again")

    backend = fake_backend()
    render_sequence(with_jpeg(5), 1, cache_dir=tmp_path / "a", backend=backend)
    worse = render_sequence(
        with_jpeg(2), 1, cache_dir=tmp_path / "a", backend=replace(backend, renderer=forbidden)
    )
    anew = render_sequence(with_jpeg(2), 1, cache_dir=tmp_path / "b", depth=True, backend=backend)
    assert digest(worse) == digest(anew)
    assert worse.segments == anew.segments
    for name, column in anew.frame_truth.items():
        np.testing.assert_array_equal(worse.frame_truth[name], column)


def test_another_noise_seed_draws_only_the_noise_anew(tmp_path, rendered):
    calls = []

    def counted(number: int | None):
        backend = replace(
            fake_backend(), build_world=lambda *a: calls.append(a) or fake_backend().build_world(*a)
        )
        scenario = SCENARIO.model_copy(update={"noise_seed": number})
        return render_sequence(scenario, 1, cache_dir=tmp_path / "other", backend=backend)

    first, again, second = counted(1), counted(1), counted(2)
    assert digest(first) == digest(again) == digest(rendered) != digest(second)
    assert len(calls) == 1  # the world of the exposed frames
    np.testing.assert_array_equal(first.T_world_cam, second.T_world_cam)
    apart = np.array(first.frames[5], float) - second.frames[5]
    assert 0 < apart.std() < 4 * SCENARIO.camera.noise_sigma
    assert abs(apart.mean()) < 0.2


def test_frames_that_no_segment_touches_are_rendered_once(tmp_path):
    """Whatever was rendered before, the frames are those of a rendering alone."""
    times = []

    class Counted(FakeRenderer):
        def render(self, T_world_cam):
            times.append(T_world_cam)
            return super().render(T_world_cam)

    def frames(folder, *numbers):
        segments = tuple(SCENARIO.segments[k] for k in numbers)
        scenario = SCENARIO.model_copy(update={"segments": segments, "noise_seed": 5})
        backend = replace(fake_backend(), renderer=Counted)
        times.clear()
        found = render_sequence(scenario, 1, cache_dir=tmp_path / folder, backend=backend)
        return digest(found), found.frame_truth["blur_px"].tolist(), len(times)

    low, blur, swing = range(3)
    for folder, *segments in (
        ("plain",),
        ("blur", blur),
        ("low", low),
        ("swing", swing),
        ("both", blur, swing),
    ):
        *alone, rendered = frames(folder, *segments)
        *beside, anew = frames("shared", *segments)
        assert beside == alone and rendered == 40
        if folder in ("plain", "low"):
            assert anew == 40  # faded surfaces are faded in every frame
        else:
            assert anew == {"blur": 5, "swing": pytest.approx(8, abs=2), "both": 0}[folder]


@pytest.mark.parametrize(
    "segment",
    [
        {"kind": "fog", "extinction_per_m": 0.5},
        {"kind": "rolling_shutter", "readout_s": 0.03},
        {"kind": "jpeg", "quality": 5},
    ],
)
def test_segments_on_images_act_with_a_noise_seed_of_its_own(tmp_path, segment):
    plain = Scenario.model_validate({**SPEC, "segments": []})
    acting = Scenario.model_validate({**SPEC, "segments": [{**segment, "start_s": 1, "duration_s": 1}]})
    options = {"cache_dir": tmp_path, "backend": fake_backend()}
    own = {"noise_seed": 1}
    same, seen = (render_sequence(s.model_copy(update=own), 1, **options) for s in (plain, acting))
    assert digest(seen) == digest(render_sequence(acting, 1, **options)) != digest(same)


def test_fog_is_rendered_once_for_all_noise(tmp_path):
    """What acts before the lens without chance is in the exposed frames, with its measure."""
    fog = {"kind": "fog", "extinction_per_m": 0.5, "start_s": 1, "duration_s": 1, "ramp_s": 0.5}
    rows = {"kind": "rolling_shutter", "readout_s": 0.03, "start_s": 2, "duration_s": 1}
    late = {"kind": "jpeg", "quality": 5, "start_s": 1.5, "duration_s": 1}
    gaps = {"kind": "frame_drops", "share": 0.5, "start_s": 1, "duration_s": 2}

    def rendered(segments, number, folder, **options):
        scenario = Scenario.model_validate({**SPEC, "segments": segments, "noise_seed": number})
        return render_sequence(scenario, 1, cache_dir=tmp_path / folder, **options)

    idle = replace(fake_backend(), renderer=None)
    rendered([fog, rows], 1, "kept", backend=fake_backend())
    for segments in ([fog, rows], [fog, rows, late], [gaps, fog, rows]):
        again = rendered(segments, 2, "kept", backend=idle)
        anew = rendered(segments, 2, "anew", backend=fake_backend(), depth=True)
        assert digest(again) == digest(anew)
        assert again.segments == anew.segments
        for name, column in anew.frame_truth.items():
            np.testing.assert_array_equal(again.frame_truth[name], column)
    assert again.frame_truth["fog_veil"].max() > 0 and len(again) < 40


def test_a_corrupt_entry_is_rendered_again(tmp_path, rendered, caplog):
    before = digest(rendered)
    stack = next((tmp_path / "cache").glob("*/gray.npy"))
    data = bytearray(stack.read_bytes())
    data[-5] ^= 0xFF
    stack.write_bytes(bytes(data))
    with caplog.at_level(logging.WARNING):
        again = render_sequence(SCENARIO, 1, cache_dir=tmp_path / "cache", backend=fake_backend())
    assert "corrupt" in caplog.text
    assert digest(again) == before


def test_the_written_folder_is_the_sequence(tmp_path):
    out = tmp_path / "out"
    options = {"cache_dir": tmp_path / "cache", "backend": fake_backend()}
    sequence = render_sequence(SCENARIO, 1, out_dir=out, **options)
    read = load_sequence(out)
    assert digest(read) == digest(sequence)
    np.testing.assert_allclose(read.T_world_cam, sequence.T_world_cam, atol=1e-8)
    assert read.segments == sequence.segments
    assert read.meta["spec"]["name"] == "trial"
    with pytest.raises(InputError, match="already holds files"):
        render_sequence(SCENARIO, 1, out_dir=out, **options)


def test_a_full_disk_is_an_input_error_and_leaves_no_half_entry(tmp_path, monkeypatch):
    from dslab.sim.io.raw import RawWriter

    def full(self, frame):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RawWriter, "append", full)
    with pytest.raises(InputError, match="No space left"):
        render_sequence(SCENARIO, 1, cache_dir=tmp_path / "cache", backend=fake_backend())
    assert list((tmp_path / "cache").iterdir()) == []


_IN_ANOTHER_PROCESS = """
import hashlib, json, sys
from pathlib import Path
from dslab.scenarios.spec import Scenario
from dslab.sim.sequence_rendering import render_sequence
s = render_sequence(Scenario.model_validate(json.loads(sys.argv[1])), 5, cache_dir=Path(sys.argv[2]))
print(hashlib.sha256(b"".join(f.tobytes() for f in s.frames)).hexdigest())
"""


@pytest.mark.slow
def test_same_seed_same_bytes_in_another_process(tmp_path):
    """The real renderer, in two processes with caches of their own."""
    spec = {**SPEC, "duration_s": 3.8}
    command = [sys.executable, "-c", _IN_ANOTHER_PROCESS, json.dumps(spec), str(tmp_path / "theirs")]
    other = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    own = render_sequence(
        Scenario.model_validate(spec), 5, cache_dir=tmp_path / "own", backend=render_backend()
    )
    assert digest(own) == other.stdout.strip()
