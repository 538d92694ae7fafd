"""Every page that the lab writes, in a real browser: nothing fails, no text is cut, links and folds work."""

import shutil
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlparse

import pytest
from slam_fakes import FakeSystem, make_sequence

from dslab.experiments.comparison.page import compare_runs
from dslab.experiments.gallery.build import make_gallery
from dslab.experiments.report.write import write_report
from dslab.experiments.result_folder import run_systems

ROOT = Path(__file__).parents[1]
WIDTHS_PX = (1400, 400)
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.slow

CUT = """() => {
    const shown = e => e.checkVisibility() && e.getBoundingClientRect().right > 0 && e.clientWidth > 1;
    const hides = e => ["hidden", "clip"].includes(getComputedStyle(e).overflowX);
    const cut = [...document.querySelectorAll("body, body *")].filter(e => !e.closest("svg"))
        .filter(e => e.scrollWidth > e.clientWidth + 1 && hides(e) && shown(e) && e.innerText?.trim());
    const over = document.documentElement.scrollWidth - window.innerWidth;
    const plots = [...document.images].filter(i => i.src.startsWith("data:") && shown(i))
        .filter(i => i.width > i.naturalWidth + 1 || i.height < 100);
    return [...plots.map(i => `not shown, or blown up: ${i.alt}`),
            ...cut.map(e => `cut: <${e.tagName} class="${e.className}"> ${e.innerText.slice(0, 60)}`),
            ...(over > 0 ? [`${over} px wider than the window`] : [])];
}"""
LINKS = "() => [...document.querySelectorAll('a[href]')].map(a => a.getAttribute('href'))"


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api")
    if BROWSER is None:
        pytest.skip("no chromium")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield started
        started.close()


def report(folder):
    shutil.copytree(ROOT / "docs" / "eq1-quick", folder / "experiment")
    return [write_report(folder / "experiment")]


def comparison(folder):
    sequence = make_sequence(60, segment=None)
    for kind, breaks_at in (("base", None), ("dual", 30)):
        (folder / kind).mkdir()
        fake = FakeSystem(sequence.T_world_cam, kind, starts_at=0, breaks_at=breaks_at, recovers=False)
        run_systems(sequence, [kind], 0, folder / kind, build=lambda *_, fake=fake: fake)
    compare_runs([folder / "base", folder / "dual"], folder / "page")
    return [folder / "page" / "index.html"]


def gallery(folder):
    make_gallery(["small/room", "small/city"], folder / "gallery", seeds=1, frames=3)
    return [folder / "gallery" / "index.html"]


def site(folder):
    # A server shows 404.html, whose links start at its root.
    pages = [page for page in sorted((ROOT / "site").rglob("*.html")) if page.name != "404.html"]
    if not pages:
        pytest.skip("no site: run `make docs` first")
    return pages


@pytest.mark.parametrize("write", [report, comparison, gallery, site], ids=lambda write: write.__name__)
def test_pages_work_in_a_browser(browser, write, tmp_path):
    faults = [f"{page.name}: {fault}" for page in write(tmp_path) for fault in faults_of(browser, page)]
    assert not faults, "\n".join(faults)


def faults_of(browser, path):
    """What is wrong with a page, at every width."""
    page = browser.new_page()
    said = []
    # The driver keeps a note on its handlers, which a built-in method has no place for.
    page.on("console", lambda message: said.append(message))  # noqa: PLW0108
    page.on("pageerror", lambda error: said.append(error))  # noqa: PLW0108
    for width in WIDTHS_PX:
        page.set_viewport_size({"width": width, "height": 900})
        page.goto(path.as_uri())
        yield from (f"{width} px: {fault}" for fault in page.evaluate(CUT))
        yield from (f"{width} px: the fold {fold!r} stays shut" for fold in stuck_folds(page))
        yield from (f"{width} px, folds open: {fault}" for fault in page.evaluate(CUT))
        if width == WIDTHS_PX[0]:
            yield from (
                f"dead link {link}" for link in page.evaluate(LINKS) if not leads_somewhere(page, path, link)
            )
    yield from (f"console: {getattr(m, 'text', m)}" for m in said if getattr(m, "type", "error") == "error")
    page.close()


def stuck_folds(page):
    """Opens every fold of a page; those that a click does not open."""
    for fold in page.query_selector_all("details:not([open]) > summary"):
        if fold.is_visible():
            fold.click()
            if not fold.evaluate("summary => summary.parentElement.open"):
                yield fold.inner_text()


def leads_somewhere(page, path, link):
    """True for another site, and for a file or a place on a page that exist."""
    file, place = urldefrag(link)
    if urlparse(file).scheme:
        return True
    target = path if not file else (path.parent / unquote(file))
    target = target / "index.html" if target.is_dir() else target
    if not target.is_file():
        return False
    if not place:
        return True
    return place in ("top",) or f'id="{unquote(place)}"' in target.read_text(encoding="utf-8")
