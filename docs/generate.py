"""Pages of the documentation: what is made from code and records, and the source of the site.

    python docs/generate.py --write     fills in what is made, in the pages of this folder
    python docs/generate.py FOLDER      writes the source of the site

``<!-- made: NAME -->`` in a page begins what the function NAME of ``made``, ``figures`` or ``claim_tables``
returns, and ``<!-- code: FILE -->`` a file, up to ``<!-- end -->``. ``<!-- site: TEXT -->`` stands on the
site alone.
"""

import re
import shutil
import sys
from pathlib import Path

import claim_tables
import figures
import made

HERE = Path(__file__).parent
ROOT = HERE.parent
ROOT_PAGES = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md")
"""Pages at the root of the repository that are on the site too."""
EXPERIMENTS = ("eq1", "eq1-doses", "eq1-vga", "eq1-quick")
"""Folders with records of experiments, of which the site has the reports."""
BLOCK = re.compile(
    r"<!-- (?P<kind>made|code): (?P<name>\S+) -->(\n((?!<!-- (made|code):).)*?<!-- end -->)?", re.DOTALL
)
RECORDS = (*EXPERIMENTS, "profiles", "direct-thread", "ldso", "ldso-flicker", "rescue", "threads")
OF_CLAIMS = ("*.parquet", "spec.yaml", "figures.json")
"""What the folders of claims hold beside the figures, which the site has."""
NOT_ON_THE_SITE = ("*.py", "__pycache__", "notebook", *RECORDS, *OF_CLAIMS)


def main(argument: str) -> None:
    """Fill in the pages of this folder, or write the source of the site into another one."""
    if argument == "--write":
        for page in HERE.glob("*.md"):
            page.write_text(filled(page.read_text()))
    else:
        write_site(Path(argument))


def filled(page: str) -> str:
    """A page with what is made between its markers."""

    def block(found: re.Match[str]) -> str:
        kind, name = found["kind"], found["name"]
        if kind == "code":
            content = f"```python\n{(ROOT / name).read_text()}```\n"
        else:
            content = next(getattr(of, name) for of in (claim_tables, figures, made) if hasattr(of, name))()
        content = re.sub(r"\n{3,}(?=#)", "\n\n", content.strip())
        return f"<!-- {kind}: {name} -->\n\n{content}\n\n<!-- end -->"

    return BLOCK.sub(block, page)


def write_site(folder: Path) -> None:
    """Write the source of the site into a folder, which is emptied before."""
    from stress_pictures import draw_pictures

    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(HERE, folder, ignore=shutil.ignore_patterns(*NOT_ON_THE_SITE))
    draw_pictures(folder / "stress")
    for name in EXPERIMENTS:
        write_experiment_report(name, folder / name)
    for page in folder.rglob("*.md"):
        page.write_text(on_the_site(filled(page.read_text())))
    for name in ROOT_PAGES:
        (folder / name.lower()).write_text(on_the_site(of_the_root((ROOT / name).read_text())))


def write_experiment_report(name: str, folder: Path) -> None:
    """Write the report of an experiment's committed records, with its page and plots."""
    from dslab.experiments.campaign.folder import read_experiment
    from dslab.experiments.report.content import report_content
    from dslab.experiments.report.write import write_files

    folder.mkdir()
    records = HERE / name
    write_files(report_content(*read_experiment(records), records.relative_to(ROOT)), folder)


def of_the_root(text: str) -> str:
    """The text of a page of the repository's root with links that lead to pages of the site."""
    text = text.replace("](docs/", "](")
    for name in ROOT_PAGES:
        text = text.replace(f"]({name}", f"]({name.lower()}")
    return text


def on_the_site(page: str) -> str:
    """A page with what only the site has, and paths in place of links to the notebook."""

    def path(found: re.Match[str]) -> str:
        words, file = found[1], f"`docs/{found[2]}`"
        return file if f"/{words}.md" in file else f"{words} ({file})"

    page = re.sub(r"<!-- site: (.+?) -->", r"\1", page, flags=re.DOTALL)
    return re.sub(r"\[([^]]+)\]\((notebook/[^)#]+)[^)]*\)", path, page)


if __name__ == "__main__":
    main(sys.argv[1])
