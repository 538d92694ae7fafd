"""Page of a gallery: one HTML file without a script, beside its pictures."""

from collections.abc import Sequence as Many
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from dslab.experiments.gallery.plan_map import kind_colour
from dslab.experiments.gallery.sheet import Sheet, Thumb
from dslab.experiments.pages import render_page
from dslab.scenarios.describe import describe_kind, describe_severity, describe_span
from dslab.scenarios.describe_family import describe_distribution, describe_parameter, parameter_label
from dslab.scenarios.families import Family
from dslab.scenarios.segments import SEGMENT_KINDS

_TEMPLATES = Path(__file__).with_name("templates")
_SHOWN_BLUR_PX = 2.0


@dataclass(frozen=True)
class Entry:
    """A family without members, or one member, with its sheets.

    Attributes:
        family: as loaded.
        group: the family that the member belongs to, or the family itself.
        sheets: one per seed.
    """

    family: Family
    group: Family
    sheets: tuple[Sheet, ...]

    @property
    def anchor(self) -> str:
        """Id of the entry's section in the page."""
        return self.family.name.replace("/", ".")

    @property
    def is_member(self) -> bool:
        """True for a member of a family."""
        return self.family.name != self.group.name

    @property
    def cover(self) -> Thumb:
        """The first frame within a segment, else the middle frame."""
        thumbs = self.sheets[0].thumbs
        return next((t for t in thumbs if t.segment is not None), thumbs[len(thumbs) // 2])


def gallery_html(entries: Many[Entry], made_by: str) -> str:
    """Write the HTML text.

    Args:
        entries: at least one; members of a family follow one another.
        made_by: program and version, for the footer.
    """
    filters = (
        describe_kind,
        describe_severity,
        describe_span,
        frame_facts,
        kind_of,
        parameter_rows,
        percent_of,
    )
    return render_page(
        _TEMPLATES,
        {f.__name__: f for f in filters},
        groups=[list(members) for _, members in groupby(entries, key=lambda entry: entry.group.name)],
        scenarios=len(entries),
        sequences=sum(len(entry.sheets) for entry in entries),
        colours={kind: kind_colour(kind) for kind in SEGMENT_KINDS},
        made_by=made_by,
    )


def parameter_rows(entry: Entry) -> list[tuple[str, ...]]:
    """Label, distribution and value per seed of each drawn parameter, without equal rows."""
    family = entry.family
    rows = {}
    for place, distribution in family.parameters.items():
        drawn = (
            describe_distribution(place, distribution, family.written, sheet.scenario) or "–"
            for sheet in entry.sheets
        )
        rows[(parameter_label(place, family.written), describe_parameter(place, distribution), *drawn)] = None
    return list(rows)


def kind_of(thumb: Thumb, sheet: Sheet) -> str | None:
    """Kind of the segment that a frame lies in, None for a clean frame."""
    return None if thumb.segment is None else sheet.scenario.segments[thumb.segment].kind


def frame_facts(thumb: Thumb, sheet: Sheet) -> list[str]:
    """Time, kind of segment and visible blur of a frame."""
    kind = kind_of(thumb, sheet)
    found = [f"{thumb.stamp_s:.2f} s"] + ([describe_kind(kind)] if kind else [])
    return found + ([f"blur {thumb.blur_px:.2g} px"] if thumb.blur_px >= _SHOWN_BLUR_PX else [])


def percent_of(part: float, whole: float) -> str:
    """A CSS length in percent."""
    return f"{100 * part / whole:.2f}%"
