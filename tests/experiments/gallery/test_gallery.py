"""The gallery: a folder with a page that shows every requested scenario with true frames."""

import re
import shutil
import subprocess
from collections import Counter

import cv2
import pytest
from html_page import Page

from dslab.experiments.gallery.build import make_gallery
from dslab.scenarios.errors import InputError
from dslab.scenarios.families import load_family
from dslab.sim.sequence_rendering import render_sequence

CAMERA = "{width_px: 320, height_px: 240, fx_px: 230, fy_px: 230, cx_px: 159.5, cy_px: 119.5, fps: 10}"
PAIR = f"""
name: pair
description: Two <b>short</b> corridors & "more".
duration_s: 3
world: {{kind: corridor, length_m: {{uniform: [10, 12]}}, turns: 0}}
trajectory: {{gaze_deg: 90}}
camera: {CAMERA}
members:
  dim:
    segments:
      - {{kind: low_light, start_s: 0.5, duration_s: 1, illumination: {{log_uniform: [0.01, 0.02]}}}}
  calm: {{description: Nothing happens.}}
"""
LONE = f"""
name: lone
duration_s: 2
world: {{kind: corridor, length_m: 10, turns: 0}}
camera: {CAMERA}
segments:
  - {{kind: fast_rotation, start_s: 0.5, duration_s: 1, rate_degps: 90}}
"""
TOO_MANY_TURNS = LONE.replace("turns: 0", "turns: 50")


@pytest.fixture(scope="module")
def scenario_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenarios")
    for name, text in (("pair", PAIR), ("lone", LONE), ("impossible", TOO_MANY_TURNS)):
        (folder / f"{name}.yaml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def gallery(scenario_files, tmp_path_factory):
    """A gallery of a family of two and a lone scenario, and its progress steps."""
    steps = []
    names = [str(scenario_files / name) for name in ("lone.yaml", "pair.yaml", "pair.yaml/dim")]
    made = make_gallery(
        names,
        tmp_path_factory.mktemp("out") / "gallery",
        seeds=1,
        frames=4,
        progress=lambda step, done, total: steps.append((done, total)),
    )
    return made, steps


@pytest.fixture(scope="module")
def page(gallery):
    return Page(gallery[0].read_text())


@pytest.mark.slow
def test_the_page_names_every_scenario_once(gallery, page):
    assert gallery[1] == [(1, 3), (2, 3), (3, 3)]
    articles = [attrs["id"] for attrs in page.all("article")]
    assert articles == ["lone", "pair.dim", "pair.calm"]
    for name in ("pair/dim", "pair/calm", "lone"):
        assert f"dslab export {name} --seed 0 --out DIR" in page.text


def test_the_page_is_well_formed_and_its_links_have_targets(page):
    ids = Counter(attrs["id"] for _, attrs in page.elements if "id" in attrs)
    assert set(ids.values()) == {1}
    for attrs in page.all("a"):
        assert attrs["href"].removeprefix("#") in ids
    assert not page.all("script")


def test_descriptions_are_escaped(page):
    assert not [attrs for attrs in page.all("b") if attrs]
    assert 'Two <b>short</b> corridors & "more".' in page.text
    assert "Nothing happens." in page.text


def test_every_picture_exists_and_every_file_is_shown(gallery, page):
    folder = gallery[0].parent
    shown = {attrs["src"] for attrs in page.all("img")}
    assert all(attrs["alt"] for attrs in page.all("img"))
    for name in shown:
        assert cv2.imread(str(folder / name)) is not None
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert files == shown | {"index.html"}


def test_images_have_their_true_size(gallery, page):
    for attrs in page.all("img"):
        height, width = cv2.imread(str(gallery[0].parent / attrs["src"])).shape[:2]
        assert (int(attrs["width"]), int(attrs["height"])) == (width, height)


def test_segments_are_shown_with_their_severity(page):
    inside = Counter(attrs["class"] for attrs in page.all("figure") if "class" in attrs)
    assert inside["inside low_light"] >= 1
    assert inside["inside fast_rotation"] >= 1
    assert Counter(attrs.get("class") for attrs in page.all("span"))["bar low_light"] == 1
    assert "low light0.5 to 1.5 sillumination 0.01" in page.text
    assert "rate 90 °/s, axis yaw" in page.text
    assert "No segment: nothing is degraded." in page.text


def test_parameters_are_shown_with_the_drawn_values(page, scenario_files):
    assert "world, corridor: length" + "uniform from 10 to 12 m" in page.text
    assert "segment 1, low light: illumination" + "log-uniform from 0.01 to 0.02" in page.text
    drawn = load_family(scenario_files / "pair.yaml" / "dim").sample(0)
    assert f"{drawn.world.length_m:.4g} m" in page.text
    assert f"{drawn.segments[0].illumination:.4g}" in page.text


def test_a_thumbnail_is_the_reduced_frame_of_the_sequence(gallery, scenario_files, tmp_path):
    folder = gallery[0].parent
    whole = render_sequence(load_family(scenario_files / "pair.yaml" / "dim").sample(0), cache_dir=tmp_path)
    pictures = sorted((folder / "pictures" / "pair.dim" / "seed-0").glob("*.jpg"))
    html = gallery[0].read_text()
    shown = [int(frame) for frame in re.findall(r"Frame (\d+) of pair/dim, seed 0,", html)]
    assert len(shown) == len(pictures) == 4
    for frame, picture in zip(shown, pictures, strict=True):
        thumbnail = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
        size = (thumbnail.shape[1], thumbnail.shape[0])
        small = cv2.resize(whole.frames[frame], size, interpolation=cv2.INTER_AREA)
        assert cv2.PSNR(small, thumbnail) > 30
        others = [k for k in (frame - 3, frame + 3) if 0 <= k < len(whole)]
        for other in others:
            assert cv2.PSNR(cv2.resize(whole.frames[other], size), thumbnail) < cv2.PSNR(small, thumbnail)


@pytest.mark.slow
def test_workers_make_the_same_gallery(gallery, scenario_files, tmp_path):
    made = make_gallery([str(scenario_files / "pair.yaml")], tmp_path / "two", seeds=1, frames=4, workers=2)
    one, two = gallery[0].parent / "pictures/pair.dim", made.parent / "pictures/pair.dim"
    names = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(two) for path in two.rglob("*") if path.is_file())
    assert all((one / name).read_bytes() == (two / name).read_bytes() for name in names)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_impossible_world_leaves_nothing_behind(workers, scenario_files, tmp_path):
    with pytest.raises(InputError, match="turns"):
        make_gallery([str(scenario_files / "impossible.yaml")], tmp_path / "out", 1, 2, workers)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_files_is_refused(scenario_files, tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match="already holds files"):
        make_gallery([str(scenario_files / "lone.yaml")], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_two_scenarios_of_one_name_are_refused(scenario_files, tmp_path):
    (tmp_path / "other.yaml").write_text(LONE)
    with pytest.raises(InputError, match="also the name"):
        make_gallery([str(scenario_files / "lone.yaml"), str(tmp_path / "other.yaml")], tmp_path / "out")


def test_the_command_passes_its_options_on_and_prints_the_page(dslab, monkeypatch, tmp_path):
    asked = []

    def make(*arguments):
        asked.append(arguments[:-1])
        return arguments[1] / "index.html"

    monkeypatch.setattr("dslab.experiments.gallery.build.make_gallery", make)
    out = tmp_path / "out"
    code, printed, _ = dslab("scenarios", "gallery", "lone", "--out", out, "--seeds", "2", "--frames", "3")
    assert code == 0 and asked == [(["lone"], out, 2, 3, 1)]
    assert printed == f"{out / 'index.html'}\n"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium")
def test_a_browser_shows_every_picture_without_errors(gallery, page, tmp_path):
    folder = shutil.copytree(gallery[0].parent, tmp_path / "copy")
    pictures = len(page.all("img"))
    assert seen_by_browser(folder, tmp_path) == (f"{pictures} shown, 0 missing, 0 wide", False)
    # A missing file is detected: here the first picture, shown twice on the page.
    (folder / page.all("img")[0]["src"]).unlink()
    assert seen_by_browser(folder, tmp_path) == (f"{pictures - 2} shown, 2 missing, 0 wide", True)


def seen_by_browser(folder, profile) -> tuple[str, bool]:
    """Pictures shown and missing in a headless Chromium, and True for console messages."""
    html = (
        (folder / "index.html")
        .read_text()
        .replace(' loading="lazy"', "")
        .replace("<details", "<details open")
    )
    watch = """<head><script>
        let missing = 0;
        addEventListener('error', () => { missing += 1; console.error('missing'); }, true);
        addEventListener('load', () => {
            const shown = [...document.images].filter(image => image.naturalWidth > 0).length;
            const page = document.documentElement;
            const wide = page.scrollWidth - page.clientWidth;
            document.title = `${shown} shown, ${missing} missing, ${wide} wide`;
        });
    </script>"""
    (folder / "watched.html").write_text(html.replace("<head>", watch))
    done = subprocess.run(
        [
            "chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
            "--disable-background-networking", f"--user-data-dir={profile / 'profile'}",
            "--enable-logging=stderr", "--window-size=400,900", "--virtual-time-budget=20000", "--dump-dom",
            (folder / "watched.html").as_uri(),
        ],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    return done.stdout.split("<title>")[1].split("</title>")[0], "CONSOLE" in done.stderr
