"""Every command that writes frames refuses, in one line, what the disk cannot hold."""

import shutil
from types import SimpleNamespace

import pytest
from slam_fakes import make_sequence

from dslab.sim.io.tum import write_tum
from dslab.sim.rendering import gl_context

HUGE = """
name: huge
duration_s: 3600
world: {kind: room}
trajectory: {kind: walk}
camera: {width_px: 4096, height_px: 4096, fps: 1000, exposure_s: 0.001}
"""
SEGMENT = "low_light:start_s=0.1,duration_s=0.2,illumination=0.1"


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(gl_context, "gl_info", dict)
    (tmp_path / "huge.yaml").write_text(HUGE)
    return tmp_path


@pytest.mark.parametrize("command", ["run", "export"])
def test_a_scenario_that_does_not_fit_is_one_line_and_leaves_nothing(dslab, place, command):
    code, out, err = dslab(*command.split(), place / "huge.yaml", "--out", place / "o")
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert err.startswith("error: huge: 3600000 frames need up to ") and "--force" in err
    assert [path.name for path in place.iterdir()] == ["huge.yaml"]


@pytest.mark.parametrize(
    "command", [["export", "--format", "tum"], ["degrade", "--segment", SEGMENT]], ids=lambda c: c[0]
)
def test_a_folder_that_does_not_fit_is_refused_unless_forced(dslab, place, monkeypatch, command):
    write_tum(make_sequence(20, segment=None), place / "seq")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    name, *options = command
    code, _, err = dslab(name, place / "seq", *options, "--out", place / "o")
    assert code == 2 and "frames need up to" in err and not (place / "o").exists()
    assert dslab(name, place / "seq", *options, "--out", place / "o", "--force")[0] == 0
