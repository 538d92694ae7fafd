"""The page of a gallery: one HTML file beside its pictures, without a script."""

from collections.abc import Sequence as Many
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from experiments.gallery.markup import Element, document, el
from experiments.gallery.plan_map import LEVEL_M, height_colour, plan_map
from experiments.gallery.sheet import Sheet, Thumb
from experiments.gallery.timeline import segment_table, timeline
from scenarios.describe import describe_camera, describe_kind, describe_motion, describe_world, measured
from scenarios.describe_family import describe_distribution, describe_parameter, parameter_label
from scenarios.families import Family
from scenarios.segments import SEGMENT_KINDS

_STYLE = Path(__file__).with_name("style.css")
_SHOWN_BLUR_PX = 2.0
# Steps of the golden angle around the circle of hues: neighbours in the list are far apart.
_HUE_STEP_DEG = 137.508


@dataclass(frozen=True)
class Entry:
    """A family without members, or one member, with its sheets.

    Attributes:
        family: as loaded.
        group: the family whose member it is, or itself.
        sheets: one per seed.
    """

    family: Family
    group: Family
    sheets: tuple[Sheet, ...]


def gallery_html(entries: Many[Entry], made_by: str) -> str:
    """The HTML file.

    Args:
        entries: at least one; members of a family follow one another.
        made_by: program and version, for the foot of the page.
    """
    groups = [list(members) for _, members in groupby(entries, key=lambda entry: entry.group.name)]
    head = el(
        "head",
        el("meta", charset="utf-8"),
        el("meta", name="viewport", content="width=device-width, initial-scale=1"),
        el("meta", name="color-scheme", content="light dark"),
        el("title", "Scenario gallery"),
        # A page without an icon of its own asks for one that is not there.
        el("link", rel="icon", href="data:,"),
        el("style", _STYLE.read_text(encoding="utf-8") + _kind_colours()),
    )
    body = el(
        "body",
        el("a", "Skip to the scenarios", href="#scenarios", class_="skip"),
        _header(entries, len(groups)),
        el("nav", *(_contents(group) for group in groups), aria_label="Scenarios"),
        el("main", *(_group(group) for group in groups), id="scenarios"),
        el("footer", el("p", f"Made by {made_by}.")),
    )
    return document(el("html", head, body, lang="en"))


def _kind_colours() -> str:
    return "".join(
        f".{kind}{{--kind:hsl({index * _HUE_STEP_DEG % 360:.0f} 75% 47%)}}\n"
        for index, kind in enumerate(SEGMENT_KINDS)
    )


def _header(entries: Many[Entry], groups: int) -> Element:
    sheets = sum(len(entry.sheets) for entry in entries)
    counted = f"{len(entries)} scenarios in {groups} families, {sheets} sequences."
    return el(
        "header",
        el("h1", "Scenario gallery"),
        el("p", counted),
        el(
            "p",
            "Every frame is the very frame of the whole sequence, made smaller. Frames are numbered in the "
            "order of time, on the map and on the axis of time too. A coloured frame lies in the time a "
            "segment was asked for; ",
            el("code", "dslab render"),
            " tells on which frames it truly acts. On the map a ring is the start, a square the end, a short "
            "line from a frame the camera's gaze; grey lines are what stands at the camera's height or up to "
            "a metre below.",
        ),
    )


def _contents(group: Many[Entry]) -> Element:
    items = [
        el(
            "li",
            el(
                "a",
                _picture(_telling(entry.sheets[0]), f"A frame of {entry.family.name}"),
                el("span", entry.family.name),
                href=f"#{anchor(entry.family.name)}",
            ),
        )
        for entry in group
    ]
    return el("section", el("h2", group[0].group.name), el("ul", *items))


def anchor(name: str) -> str:
    """The id of a scenario's section."""
    return name.replace("/", ".")


def _telling(sheet: Sheet) -> Thumb:
    """The first frame in a segment, or else the one in the middle."""
    inside = [thumb for thumb in sheet.thumbs if thumb.segment is not None]
    return inside[0] if inside else sheet.thumbs[len(sheet.thumbs) // 2]


def _group(group: Many[Entry]) -> Element:
    family = group[0].group
    if family.name == group[0].family.name:
        return el("section", _entry(group[0], "h2"))
    intro = [el("h2", family.name), el("p", family.description, class_="description")]
    return el("section", *intro, *(_entry(entry, "h3") for entry in group))


def _entry(entry: Entry, heading: str) -> Element:
    family, own = entry.family, entry.family.description
    told = own if heading == "h2" or own != entry.group.description else None
    seeds = [_sheet(sheet, is_open=place == 0) for place, sheet in enumerate(entry.sheets)]
    return el(
        "article",
        el(
            heading,
            family.name,
            " ",
            el("a", "#", href=f"#{anchor(family.name)}", aria_label=f"Link to {family.name}"),
        ),
        el("p", told, class_="description") if told else None,
        _parameters(entry),
        *seeds,
        id=anchor(family.name),
    )


def _parameters(entry: Entry) -> Element:
    """What varies, how, and what each seed drew; alike rows of a choice's options once."""
    family, sheets = entry.family, entry.sheets
    if not family.parameters:
        return el("p", "No parameter is drawn: seeds differ in world, path and noise.", class_="none")
    rows: dict[tuple[str, ...], None] = {}
    for place, distribution in family.parameters.items():
        drawn = (
            describe_distribution(place, distribution, family.written, sheet.scenario) or "–"
            for sheet in sheets
        )
        rows[(parameter_label(place, family.written), describe_parameter(place, distribution), *drawn)] = None
    names = ("parameter", "drawn", *(f"seed {sheet.scenario.seed}" for sheet in sheets))
    table = el(
        "table",
        el("thead", el("tr", *(el("th", name, scope="col") for name in names))),
        el("tbody", *(el("tr", *(el("td", cell) for cell in row)) for row in rows)),
    )
    count = f"{len(rows)} parameter{'' if len(rows) == 1 else 's'}"
    return el(
        "details",
        el("summary", count),
        el("div", table, class_="scroll"),
        open="" if len(rows) <= 12 else None,
    )


def _sheet(sheet: Sheet, is_open: bool) -> Element:
    scenario = sheet.scenario
    kinds = ", ".join(describe_kind(s.kind) for s in scenario.segments) or "no segment"
    return el(
        "details",
        el("summary", f"Seed {scenario.seed}: {kinds}"),
        el(
            "div",
            *(_shot(sheet, number, thumb) for number, thumb in enumerate(sheet.thumbs, 1)),
            class_="shots",
        ),
        el(
            "div",
            _map(sheet),
            el("div", timeline(sheet), segment_table(sheet)),
            _facts(sheet),
            class_="about",
        ),
        class_="seed",
        open="" if is_open else None,
    )


def _shot(sheet: Sheet, number: int, thumb: Thumb) -> Element:
    kind = None if thumb.segment is None else sheet.scenario.segments[thumb.segment].kind
    words = [f"{thumb.stamp_s:.2f} s"]
    if kind:
        words.append(describe_kind(kind))
    if thumb.blur_px >= _SHOWN_BLUR_PX:
        words.append(f"blur {thumb.blur_px:.2g} px")
    what = f"Frame {thumb.frame} of {sheet.scenario.name}, seed {sheet.scenario.seed}, at {', '.join(words)}"
    return el(
        "figure",
        _picture(thumb, what),
        el("figcaption", el("b", str(number)), " " + " · ".join(words)),
        class_=f"inside {kind}" if kind else None,
    )


def _picture(thumb: Thumb, alt: str) -> Element:
    return el("img", src=thumb.file, alt=alt, width=thumb.width_px, height=thumb.height_px, loading="lazy")


def _map(sheet: Sheet) -> Element:
    caption: list[Element | str] = ["From above."]
    if sheet.track.climb_m > LEVEL_M:
        height_m = sheet.track.position_m[:, 2]
        caption += [
            f" Height from {measured(height_m.min())} m ",
            el("span", class_="ramp", style=f"--low:{height_colour(0)};--high:{height_colour(1)}"),
            f" to {measured(height_m.max())} m.",
        ]
    return el("figure", plan_map(sheet), el("figcaption", *caption))


def _facts(sheet: Sheet) -> Element:
    scenario, track = sheet.scenario, sheet.track
    facts = {
        "world": describe_world(scenario),
        "motion": describe_motion(scenario),
        "camera": describe_camera(scenario),
        "duration": f"{scenario.duration_s:g} s, {sheet.frames} frames",
        "path": f"{measured(track.length_m)} m, up and down by {measured(track.climb_m)} m",
        "fastest": f"{measured(track.speed_mps.max())} m/s, {measured(track.rate_degps.max())} °/s",
    }
    terms = [part for name, text in facts.items() for part in (el("dt", name), el("dd", text))]
    command = f"dslab render {scenario.name} --seed {scenario.seed} --out DIR"
    return el("div", el("dl", *terms), el("p", el("code", command)), class_="facts")
