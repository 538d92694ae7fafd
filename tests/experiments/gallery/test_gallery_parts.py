"""Parts of a gallery: choice of frames, map, page."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from html_page import Page

from dslab.experiments.gallery.page import Entry, gallery_html
from dslab.experiments.gallery.plan_map import SIZE_PX, draw_map, kind_colour, level_cut
from dslab.experiments.gallery.sheet import Sheet, Thumb, chosen_frames
from dslab.scenarios.families import load_family
from dslab.scenarios.segment_text import parse_segment
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.timing import FrameDropsDegradation
from dslab.sim.worlds.base import Surface, WorldModel


def plan_of(frames: int) -> FramePlan:
    """Ten frames per second along no path."""
    none = np.zeros(frames)
    return FramePlan(np.arange(frames) / 10, None, none, np.empty(0), np.empty((frames, 0), np.float32))  # pyright: ignore


@pytest.mark.parametrize("count", [1, 9])
def test_every_segment_has_a_frame_and_the_others_are_spread(count):
    plan = plan_of(300)
    segments = tuple(
        parse_segment(f"fog:start_s={t},duration_s=0.4,extinction_per_m=1") for t in (3, 3.5, 20)
    )
    chosen = chosen_frames(plan, segments, count)
    assert chosen == sorted(set(chosen))
    assert len(chosen) == max(count, len(segments))
    assert all(plan.within(segment)[chosen].any() for segment in segments)
    assert chosen_frames(plan, (), count) == np.linspace(0, 299, count).round().astype(int).tolist()
    if count >= 9:
        assert np.diff(chosen).max() < 2 * 300 / (count - 1)


def test_a_sequence_of_few_frames_shows_each_once():
    assert chosen_frames(plan_of(3), (), 8) == [0, 1, 2]


def test_dropped_frames_are_not_chosen():
    segment = parse_segment("frame_drops:start_s=3,duration_s=1,share=1")
    plan = FrameDropsDegradation().apply(plan_of(100), segment)  # pyright: ignore
    chosen = chosen_frames(plan, (segment,), 4)
    # The last frame of the segment is never dropped.
    assert plan.frame[chosen].tolist().count(39) == 1


def box(low: tuple, high: tuple) -> Surface:
    """The four walls of a box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    vertices = np.array([(*corner, z) for z in (z0, z1) for corner in corners], float)
    sides = [(k, (k + 1) % 4) for k in range(4)]
    triangles = np.array([t for a, b in sides for t in ((a, b, b + 4), (a, b + 4, a + 4))], np.int32)
    return Surface(vertices, triangles, np.zeros((8, 2)), np.zeros((2, 2), np.uint8), "box")


def test_a_level_cut_is_the_floor_plan():
    world = WorldModel([box((0, 0, 0), (4, 3, 2)), box((9, 9, 5), (10, 10, 6))], 118.0)
    cut = level_cut(world, 1.0)
    assert np.linalg.norm(np.diff(cut, axis=1), axis=-1).sum() == pytest.approx(2 * (4 + 3))
    on_side = np.isclose(cut[..., 0] % 4, 0) | np.isclose(cut[..., 1] % 3, 0)
    assert on_side.all()
    assert len(level_cut(world, 3.0)) == 0


FAR = box((40, 40, 0), (41, 41, 1))


def drawn(tmp_path, *surfaces, segments=(), heights_m=(1.5, 1.5)):
    """Map of a way from (0, 0) to (10, 0) that climbs, BGR."""
    position_m = np.column_stack([np.linspace(0, 10, 200), np.zeros(200), np.repeat(heights_m, 100)])
    gaze, world = np.array([[0.0, 1.0, 0.0]]), WorldModel([FAR, *surfaces], 118.0)
    draw_map(tmp_path / "map.png", world, position_m, list(segments), position_m[:1], gaze)
    return cv2.imread(str(tmp_path / "map.png")).astype(int)


def changed(one, other):
    return np.nonzero((one != other).any(axis=2))


def test_the_map_shows_the_world_the_segments_and_every_storey(tmp_path):
    low, high = box((4, 2, 0), (6, 3, 3)), box((4, -3, 3), (6, -2, 6))
    empty, floor = drawn(tmp_path), drawn(tmp_path, low, high)
    rows, columns = changed(floor, empty)
    assert rows.max() < SIZE_PX / 2 and columns.min() > 0.2 * SIZE_PX and columns.max() < 0.8 * SIZE_PX
    assert changed(drawn(tmp_path, low, high, heights_m=(1.5, 4.5)), floor)[0].min() > SIZE_PX / 2
    fog = drawn(tmp_path, segments=[("fog", np.array([[2.0, 0, 1.5], [4, 0, 1.5]]))])
    assert 50 < len(changed(fog, empty)[0]) < 5000


def test_kinds_have_colours_of_their_own():
    assert len({kind_colour(kind) for kind in SEGMENT_KINDS}) == len(SEGMENT_KINDS)


def test_a_page_shows_every_seed_and_escapes_texts():
    fog = {"kind": "fog", "start_s": 10, "duration_s": 5, "extinction_per_m": 0.5}
    scenario = Scenario(name="stairs", duration_s=60, world={"kind": "room"}, segments=[fog])
    thumb = Thumb("a.jpg", 32, 24, 375, 12.5, 0, 0.0)
    sheet = Sheet(scenario, (thumb,), "map.png", {"world": "a <b>room</b>"})
    family = replace(load_family("clean-room"), description="<b>Bold</b> & true")
    page = Page(gallery_html([Entry(family, family, (sheet, sheet))], "<i>"))
    seeds = [details for details in page.all("details") if details.get("class") == "seed"]
    assert ["open" in details for details in seeds] == [True, False]
    assert "<b>Bold</b> & true" in page.text and "Made by <i>." in page.text and "a <b>room</b>" in page.text
    assert not page.all("i")
