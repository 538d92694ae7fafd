"""Room is checked before anything is rendered or written."""

import shutil
from types import SimpleNamespace

import psutil
import pytest

from dslab.scenarios.errors import InputError
from dslab.scenarios.spec import Scenario
from dslab.sim.preview import preview
from dslab.sim.room import MOST_BYTES, Need, check_memory, check_room, images_need
from dslab.sim.sequence_rendering import render_sequence

HUGE = Scenario(
    name="huge",
    duration_s=3600,
    world={"kind": "room"},
    trajectory={"kind": "walk"},
    camera={"width_px": 4096, "height_px": 4096, "fps": 1000, "exposure_s": 0.001},
)


@pytest.fixture
def free(monkeypatch):
    """A function that sets the free space of every disk and the free memory."""

    def set_free(disk_bytes, memory_bytes=10**12):
        monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=disk_bytes))
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=memory_bytes))

    return set_free


def test_sixty_terabytes_are_refused_before_a_world_is_built(tmp_path, free):
    free(10**12)
    with pytest.raises(
        InputError, match=r"3600000 frames need up to 60,398\.0 GB in .*, 1,000\.0 GB are free"
    ):
        render_sequence(HUGE, cache_dir=tmp_path / "cache", backend=SimpleNamespace(
            renderer_name="none", gl_info=dict,
        ))  # fmt: skip
    assert list(tmp_path.iterdir()) == []


def test_what_lies_on_one_disk_is_summed(tmp_path, free):
    needs = [Need(tmp_path / "a" / "b", 600), Need(tmp_path, 600)]
    free(1200)
    check_room("x", 1, needs)
    free(1199)
    with pytest.raises(InputError, match="free"):
        check_room("x", 1, needs)
    check_room("x", 1, needs, force=True)


def test_very_much_is_begun_only_when_asked_for(tmp_path, free):
    free(10**15)
    check_room("x", 1, [Need(tmp_path, MOST_BYTES)])
    with pytest.raises(InputError, match="--force"):
        check_room("x", 1, [Need(tmp_path, MOST_BYTES + 1)])
    check_room("x", 1, [Need(tmp_path, MOST_BYTES + 1)], force=True)


def test_memory_is_checked(free):
    free(10**15, 10**9)
    check_memory("x", 1, 10**9)
    with pytest.raises(InputError, match="of memory"):
        check_memory("x", 1, 10**9 + 1)
    with pytest.raises(InputError, match="of memory"):
        preview(HUGE, SimpleNamespace())


def test_depth_images_are_counted(tmp_path):
    assert images_need(tmp_path, 10, (4, 3)).size_bytes == 120
    assert images_need(tmp_path, 10, (4, 3), depth=True).size_bytes == 360
