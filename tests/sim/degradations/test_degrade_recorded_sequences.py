"""Degrading recorded sequences: the result, its repeatability, and refused input."""

import hashlib
import json

import cv2
import numpy as np
import pytest

from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.sim.degradations.recorded_kinds import check_recorded_sequence, recorded_sequence_kinds
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.sim.io.forms import load_sequence

COUNT, FPS = 40, 20.0
START_S = 1305031102.25


@pytest.fixture
def recorded(tmp_path):
    """Two seconds with the clock of a real recording, without truth or depth."""
    folder = tmp_path / "office"
    (folder / "rgb").mkdir(parents=True)
    rng, lines = np.random.default_rng(0), []
    wide = cv2.resize(rng.uniform(0, 255, (15, 40)).astype(np.float32), (320, 120)).astype(np.uint8)
    for frame in range(COUNT):
        cv2.imwrite(str(folder / f"rgb/{frame}.png"), wide[:, 2 * frame : 2 * frame + 160])
        lines.append(f"{START_S + frame / FPS:.6f} rgb/{frame}.png")
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n")
    (folder / "camera.yaml").write_text(
        "fx: 120\nfy: 120\ncx: 79.5\ncy: 59.5\nwidth: 160\nheight: 120\nfps: 20\n"
    )
    return folder


def add_depth(folder) -> None:
    (folder / "depth").mkdir()
    lines = []
    for frame, line in enumerate((folder / "rgb.txt").read_text().split("\n")[:COUNT]):
        cv2.imwrite(str(folder / f"depth/{frame}.png"), np.full((120, 160), 15000, np.uint16))
        lines.append(f"{line.split()[0]} depth/{frame}.png")
    (folder / "depth.txt").write_text("\n".join(lines) + "\n")


def test_the_list_has_every_kind_that_acts_and_fits_80_columns(dslab, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = dslab("degrade", "--list")
    lines = out.splitlines()
    assert code == 0 and max(map(len, lines)) <= 80
    kinds = [line.partition(":")[0] for line in lines if not line.startswith(" ")]
    assert set(recorded_sequence_kinds(depth=True)) <= set(kinds)
    assert {"motion_blur", "low_texture", "fast_rotation"} <= set(recorded_sequence_kinds(depth=False))
    assert "  exposure_s (required; 0 to 1 s)" in out and "  rate_degps (required; 0 to 1000 °/s)" in out
    assert "rendered scenarios only: pure_rotation" in " ".join(out.split())


def test_every_kind_of_a_recording_can_be_listed_and_used(recorded, tmp_path):
    add_depth(recorded)
    sequence = load_sequence(recorded)
    rng = np.random.default_rng(3)
    for kind in recorded_sequence_kinds(depth=True):
        drawn = DEGRADATIONS[kind].sample(rng) | ({"rate_degps": 50.0} if kind == "fast_rotation" else {})
        segment = SEGMENT_KINDS[kind](kind=kind, start_s=0.5, duration_s=0.3, **drawn)
        check_recorded_sequence(sequence, [segment])
        assert "Rendered scenarios only" not in (SEGMENT_KINDS[kind].__doc__ or "")
    for kind in set(DEGRADATIONS) - set(recorded_sequence_kinds(depth=True)):
        assert "Rendered scenarios only" in (SEGMENT_KINDS[kind].__doc__ or "")


def test_inertial_readings_that_would_not_turn_are_refused(dslab, recorded, tmp_path, monkeypatch):
    turn = "fast_rotation:start_s=0.5,duration_s=0.5,rate_degps=50"
    euroc = tmp_path / "euroc"
    assert dslab("degrade", recorded, "--segment", turn, "--format", "euroc", "--out", euroc)[0] == 0
    monkeypatch.setattr("dslab.experiments.runs.sources.open_imu", lambda *arguments: (None, None))
    code, _, err = dslab("degrade", euroc, "--segment", turn, "--out", tmp_path / "out")
    assert code == 2 and "inertial" in err and "--format tum" in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert dslab("degrade", euroc, "--segment", turn, "--format", "tum", "--out", tmp_path / "out")[0] == 0


def digest(folder) -> str:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


DARK = "low_light:start_s=0.5,duration_s=0.5,illumination=0.05"
DROPS = "frame_drops:start_s=1.2,duration_s=0.4,share=0.5"


def test_segments_change_only_their_own_frames_and_are_written(dslab, recorded, tmp_path):
    out = tmp_path / "out"
    code, *_ = dslab("degrade", recorded, "--segment", DARK, "--segment", DROPS, "--seed", 3, "--out", out)
    assert code == 0
    clean, degraded = load_sequence(recorded), load_sequence(out)
    assert len(degraded) == COUNT - 4  # half of 8 frames, the last of which stays: round(3.5)
    assert set(degraded.stamps_s) < set(clean.stamps_s)
    for index, stamp_s in enumerate(degraded.stamps_s):
        before = clean.frames[int(np.searchsorted(clean.stamps_s, stamp_s))]
        dark = 0.5 <= stamp_s - START_S < 1.0 - 1e-6
        assert np.array_equal(degraded.frames[index], before) == (not dark)
    low_light, drops = degraded.segments
    assert (low_light.kind, low_light.first_frame, low_light.last_frame) == ("low_light", 10, 19)
    assert low_light.severity["illumination"] == 0.05
    assert drops.kind == "frame_drops" and drops.first_frame >= 24
    assert degraded.frame_truth["frames_missing"].sum() == 4
    assert json.loads((out / "meta.json").read_text())["degraded"]["seed"] == 3


def test_the_same_seed_gives_the_same_folder(dslab, recorded, tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        segments = ["--segment", DARK, "--segment", DROPS]
        assert dslab("degrade", recorded, *segments, "--seed", seed, "--out", tmp_path / name)[0] == 0
    assert digest(tmp_path / "a") == digest(tmp_path / "b") != digest(tmp_path / "c")


def test_degrading_again_keeps_the_earlier_segments(dslab, recorded, tmp_path):
    once, twice = tmp_path / "once", tmp_path / "twice"
    jpeg = "jpeg:start_s=1.7,duration_s=0.2,quality=5"
    assert dslab("degrade", recorded, "--segment", DROPS, "--segment", jpeg, "--out", once)[0] == 0
    assert dslab("degrade", once, "--segment", DARK, "--out", twice)[0] == 0
    segments = load_sequence(twice).segments
    assert [segment.kind for segment in segments] == ["frame_drops", "jpeg", "low_light"]
    assert segments[1] == load_sequence(once).segments[1]


def test_wrong_stamps_leave_the_images_unchanged(dslab, recorded, tmp_path):
    out = tmp_path / "out"
    jitter = "time_jitter:start_s=0.5,duration_s=1,sigma_s=0.01"
    assert dslab("degrade", recorded, "--segment", jitter, "--out", out)[0] == 0
    clean, degraded = load_sequence(recorded), load_sequence(out)
    assert all(np.array_equal(a, b) for a, b in zip(clean.frames, degraded.frames, strict=True))
    moved = np.abs(clean.stamps_s - degraded.stamps_s) > 1e-6
    assert moved[10:30].all() and moved.sum() == 20


def test_fog_acts_where_depth_is_known(dslab, recorded, tmp_path):
    add_depth(recorded)
    fog = "fog:start_s=0,duration_s=1,extinction_per_m=0.5"
    assert dslab("degrade", recorded, "--segment", fog, "--out", tmp_path / "out")[0] == 0
    degraded = load_sequence(tmp_path / "out")
    assert degraded.depths is not None and (degraded.depths[3] == 3).all()
    assert degraded.frames[3].std() < 0.6 * load_sequence(recorded).frames[3].std()


@pytest.mark.parametrize(
    ("segments", "says"),
    [
        (["fog:start_s=0,duration_s=1,extinction_per_m=1"], ["fog needs a folder with depth", "low_light"]),
        (["rolling_shutter:start_s=0,duration_s=1,readout_s=0.1"], ["needs a world", "defocus"]),
        (["jpeg:start_s=1,duration_s=5,quality=9"], ["ends after the sequence", "2 s"]),
        ([DARK, DARK.replace("s=0.5,d", "s=0.9,d", 1)], ["one kind and overlap"]),
        (["motion_blur:start_s=0.1,duration_s=1,exposure_s=0.5"], ["before the first frame", "0.25 s"]),
        (["fast_rotation:start_s=0,duration_s=1,rate_degps=300"], ["leaves less than half", "rate_degps = "]),
        (["jpg:start_s=0,duration_s=1,quality=9"], ["unknown kind 'jpg'", "jpeg (did you mean"]),
        (["jpeg:start_s=0,duration_s=1,quality=900"], ["quality", "'900'", "100"]),
    ],
)  # fmt: skip
def test_an_impossible_segment_is_one_line_and_leaves_nothing(dslab, recorded, tmp_path, segments, says):
    options = [word for text in segments for word in ("--segment", text)]
    code, _, err = dslab("degrade", recorded, *options, "--out", tmp_path / "out")
    assert code == 2
    assert err.startswith("error: ") and err.count("\n") == 1
    assert all(word in err for word in says), err
    assert not (tmp_path / "out").exists()


def test_a_broken_image_leaves_nothing_behind(dslab, recorded, tmp_path):
    (recorded / "rgb/30.png").write_bytes(b"no image")
    code, _, err = dslab("degrade", recorded, "--segment", DARK, "--out", tmp_path / "out")
    assert code == 2 and "30.png" in err
    assert [path.name for path in tmp_path.iterdir()] == ["office"]
