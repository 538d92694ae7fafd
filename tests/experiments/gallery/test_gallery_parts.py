"""Parts of a gallery: choice of frames, outline, map, curves, page."""

from dataclasses import replace

import numpy as np
import pytest
from html_page import Page

from dslab.experiments.gallery.outline import draw_outline, frame_of, level_cut
from dslab.experiments.gallery.page import Entry, gallery_html
from dslab.experiments.gallery.plan_map import plan_map
from dslab.experiments.gallery.sheet import Sheet, Thumb, Track, chosen_frames
from dslab.experiments.gallery.timeline import curves
from dslab.scenarios.families import load_family
from dslab.scenarios.segment_text import parse_segment
from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.frame_drops import FrameDropsDegradation
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


def test_the_outline_is_drawn_at_the_place_of_the_objects():
    frame = frame_of(np.array([[0.0, 0.0], [10.0, 5.0]]))
    world = WorldModel([box((4, 2, 0), (6, 3, 2))], 118.0)
    picture = draw_outline(world, np.full(5, 1.5), frame)
    rows, columns = np.nonzero(picture[..., 3])
    low, high = (frame.place(np.array(corner)) * 2 for corner in ((4, 2), (6, 3)))
    assert (columns.min(), columns.max()) == pytest.approx((low[0], high[0]), abs=2)
    assert (rows.max(), rows.min()) == pytest.approx((low[1], high[1]), abs=2)


def test_every_storey_is_cut():
    frame = frame_of(np.array([[0.0, 0.0], [10.0, 5.0]]))
    world = WorldModel([box((1, 1, 0), (2, 2, 3)), box((7, 3, 3), (8, 4, 6))], 118.0)
    low, both = (draw_outline(world, np.array(z), frame)[..., 3] for z in ([1.5, 1.5], [1.5, 4.5]))
    right = frame.place(np.array([5.0, 0.0]))[0] * 2
    assert not low[:, int(right) :].any()
    assert both[:, int(right) :].any() and np.array_equal(low[:, : int(right)], both[:, : int(right)])


@pytest.mark.parametrize("points", [[[0, 0], [0, 0]], [[0, 0], [1000, 0]], [[-3, 5], [-3, 900]]])
def test_a_map_holds_the_whole_path_and_stays_small(points):
    points = np.array(points, float)
    frame = frame_of(points)
    placed = frame.place(points)
    assert (placed > 0).all() and (placed < [frame.width_px, frame.height_px]).all()
    assert max(frame.width_px, frame.height_px) <= 480


def sheet_that_climbs(climb_m: float) -> Sheet:
    stamps_s = np.linspace(0, 60, 500)
    turn = stamps_s / 60 * 2 * np.pi
    position_m = np.column_stack([20 * np.cos(turn), 20 * np.sin(turn), 1.5 + climb_m * stamps_s / 60])
    scenario = Scenario.model_validate(
        {
            "name": "stairs",
            "duration_s": 60,
            "world": {"kind": "room"},
            "segments": [{"kind": "fog", "start_s": 10, "duration_s": 5, "extinction_per_m": 0.5}],
        }
    )
    speed = np.full(500, 2.1)
    track = Track(stamps_s, position_m, speed, 2 * speed, 126.0, climb_m, (position_m[83:125],))
    thumb = Thumb("a.jpg", 32, 24, 0, 0.0, None, 0.0, position_m[0], np.array([0.0, 1.0]))
    inside = replace(thumb, frame=375, stamp_s=12.5, segment=0, position_m=position_m[104])
    return Sheet(scenario, 1800, (thumb, inside), track, frame_of(position_m[:, :2]), "outline.png")


def test_a_climb_is_shown_by_colour_and_over_time():
    climbing, level = sheet_that_climbs(9.0), sheet_that_climbs(0.2)
    colours = {line["style"] for line in Page(plan_map(climbing)).all("polyline") if "style" in line}
    assert len(colours) >= 5
    assert not any("style" in line for line in Page(plan_map(level)).all("polyline"))
    assert "height, 1.5 to 10.5 m" in curves(climbing)
    assert len(curves(level)) == 2


def test_the_map_marks_segments_frames_and_its_scale():
    sheet = sheet_that_climbs(0.0)
    drawn = Page(plan_map(sheet))
    assert [line["class"] for line in drawn.all("polyline")] == ["segment fog", "path"]
    assert drawn.text.endswith("1 2 start end 10 m")
    (bar,) = (path["d"] for path in drawn.all("path") if path["class"] == "scale")
    start, end = float(bar.split("V")[0].split()[0][1:]), float(bar.split("H")[1].split("V")[0])
    assert end - start == pytest.approx(10 * sheet.map_frame.px_per_m, abs=0.1)


def test_a_page_shows_every_seed_and_escapes_texts():
    family = replace(load_family("clean-room"), description="<b>Bold</b> & true")
    page = Page(gallery_html([Entry(family, family, (sheet_that_climbs(0.2), sheet_that_climbs(9)))], "<i>"))
    seeds = [details for details in page.all("details") if details.get("class") == "seed"]
    assert ["open" in details for details in seeds] == [True, False]
    assert "<b>Bold</b> & true" in page.text and "Made by <i>." in page.text
    assert not page.all("i")
