"""Build of a gallery: a folder with a page that shows scenarios."""

from contextlib import closing
from functools import partial
from pathlib import Path

from dslab.experiments.gallery.page import Entry, gallery_html
from dslab.experiments.gallery.sheet import Sheet, make_sheet
from dslab.experiments.jobs.pool import run_each
from dslab.experiments.runs.provenance import DISTRIBUTION, commit, versions
from dslab.scenarios.errors import InputError
from dslab.scenarios.families import Family, family_names, load_family
from dslab.scenarios.spec import Scenario
from dslab.sim.io.folders import Progress, new_directory

PAGE_FILE = "index.html"


def make_gallery(
    names: list[str],
    out_dir: Path,
    seeds: int = 3,
    frames: int = 8,
    workers: int = 1,
    progress: Progress | None = None,
) -> Path:
    """Make a folder with a page of thumbnails, maps and segments of every scenario.

    Args:
        names: families, members or YAML files; a family stands for all of its members. Empty for all of the
            package.
        out_dir: absent or empty.
        seeds: number of seeds per scenario, from the seed of its family on.
        frames: number of frames per sequence, at least one per segment.
        workers: processes; the result does not depend on it.
        progress: called with (step, sequences done, sequences in all).

    Returns:
        The page.

    Raises:
        InputError: a name or a file is no scenario, two scenarios share a name, no GL, the folder is not
            empty or not writable, or the disk is full.
    """
    found = _families(names)
    samples = [family.sample(family.seed + k) for family, _ in found for k in range(seeds)]
    with new_directory(out_dir) as folder:
        sheets: dict[tuple[str, int], Sheet] = {}
        # Closed before the folder is removed, so that no worker writes into it.
        with closing(run_each(partial(_sheet, frames, folder), samples, workers)) as made:
            for _, sheet in made:
                sheets[sheet.scenario.name, sheet.scenario.seed] = sheet
                if progress is not None:
                    progress("sequences", len(sheets), len(samples))
        in_order = iter([sheets[sample.name, sample.seed] for sample in samples])
        entries = [
            Entry(family, group, tuple(next(in_order) for _ in range(seeds))) for family, group in found
        ]
        (folder / PAGE_FILE).write_text(gallery_html(entries, _made_by()), encoding="utf-8")
    return out_dir / PAGE_FILE


def _families(names: list[str]) -> list[tuple[Family, Family]]:
    """Each family to sample, once, with its group; members follow one another."""
    found: dict[str, Family] = {}
    groups: dict[Path, Family] = {}
    for name in names or family_names():
        family = load_family(name)
        for one in [family.member(member) for member in family.members] or [family]:
            earlier = found.setdefault(one.name, one)
            if earlier.file.path != one.file.path:
                problem = f"is also the name of a scenario in {earlier.file.path}"
                raise InputError(
                    f"{one.file.path}: name {one.name}", problem, "give one of them another name"
                )
            if one.file.path not in groups:
                groups[one.file.path] = load_family(one.file.path) if one.member_id else one
    return [(one, group) for path, group in groups.items() for one in found.values() if one.file.path == path]


def _sheet(frames: int, folder: Path, sample: Scenario) -> Sheet:
    return make_sheet(sample, frames, folder)


def _made_by() -> str:
    return " ".join(filter(None, [DISTRIBUTION, versions()[DISTRIBUTION], commit()]))
