"""The pages are up to date, short, and what they name is there: settings, commands, files, links."""

import importlib
import re
import sys
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from dslab.experiments.claims.loading import is_claim, load_claim
from dslab.experiments.cli.commands import app
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.runs.slam_settings import read_slam_settings
from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.paper import PAPER
from dslab.slam.dual.recovery.paper import paper_orb_config
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS, ThreadSpec

ROOT = Path(__file__).resolve().parents[1]
SITE = sorted(ROOT.glob("docs/*.md"))
PAGES = [*(p for p in sorted(ROOT.glob("*.md")) if p.name != "CHANGELOG.md"), *SITE]
WRAPPED = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "ARCHITECTURE.md")
LINKED = [*sorted(ROOT.glob("*.md")), *SITE, *sorted(ROOT.glob("docs/notebook/*.md"))]
DEVIATIONS = (ROOT / "docs" / "dual-slam.md").read_text()
# What `name: value` may refer to; ORB, SIFT and DIRECT are kinds of threads, THREAD is any.
BASES: dict[str, tuple[Any, ...]] = {
    "dual": (DualConfig(),),
    "THREAD": tuple(RECOVERY_KINDS[kind](None).config for kind in ("orb", "sift", "gms", "direct")),
    "ORB": (RECOVERY_KINDS["orb"](None).config,),
    "SIFT": (RECOVERY_KINDS["sift"](None).config,),
    "DIRECT": (RECOVERY_KINDS["direct"](None).config,),
}


def plain(value: Any) -> Any:
    """A setting as YAML would give it."""
    if isinstance(value, tuple):
        return [item.kind if isinstance(item, ThreadSpec) else item for item in value]
    return value


def test_settings_have_the_defaults_that_are_stated():
    named = re.findall(r"`([A-Za-z_0-9]+(?:\.[a-z_0-9]+)*): ([^`]+)`", DEVIATIONS)[
        1:
    ]  # the first: the notation
    assert len(named) > 30
    for name, stated in named:
        first, *rest = name.split(".")
        bases, path = (BASES[first], rest) if first in BASES else ((SlamConfig(),), [first, *rest])
        for base in bases:
            value = base
            for step in path:
                assert is_dataclass(value) and step in [field.name for field in fields(value)], name
                value = getattr(value, step)
            assert plain(value) == yaml.safe_load(stated), name


def test_the_settings_of_one_deviation_from_the_paper_can_be_read(tmp_path):
    (text,) = re.findall(r"```yaml\n(.*?)```", DEVIATIONS, re.DOTALL)
    (tmp_path / "paper.yaml").write_text(text)
    camera = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0)
    _, dual = read_slam_settings(tmp_path / "paper.yaml").of("paper", camera)
    orb, sift = dual.recovery_threads
    assert dual == replace(PAPER, recovery_threads=(orb, sift)) and sift.config is None
    assert orb.config == replace(paper_orb_config(), max_unusable_s=2.0)


def commands_of(page: Path) -> list[str]:
    """Lines and inline pieces of a page that call dslab."""
    text = re.sub(r"```bibtex.*?```", "", page.read_text(), flags=re.DOTALL)
    inline = re.findall(r"`(dslab [^`]+)`", text)
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    found = [line.partition("#")[0].partition(">")[0] for line in lines]
    return inline + [
        line.removeprefix(".venv/bin/") for line in found if re.match(r"(\.venv/bin/)?dslab ", line)
    ]


WITH_COMMANDS = [page for page in PAGES if page.name != "commands.md" and commands_of(page)]


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.name)
def test_commands_and_their_options_exist(page):
    root = typer.main.get_command(app)
    for line in commands_of(page):
        command: Any = root
        words = " ".join(line.split()).replace("\\", "").split(" ")[1:]
        while words and words[0].strip(".,") in getattr(command, "commands", {}):
            command = command.commands[words.pop(0).strip(".,")]
        assert not (words and getattr(command, "commands", {})) or words[0].startswith("-"), line
        if line.startswith("dslab experiment run ") and re.fullmatch(r"[\w-]+", words[0]):
            (load_claim if is_claim(words[0]) else load_spec)(words[0])
        known = {option for each in command.params for option in (*each.opts, *each.secondary_opts)}
        assert {word.partition("=")[0] for word in words if word.startswith("--")} <= known | {"--help"}, line


def of_the_repository(page: Path) -> str:
    """A page without what stands on the site alone."""
    return re.sub(r"<!-- site: .+? -->", "", page.read_text(), flags=re.DOTALL)


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", LINKED, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_and_sections_that_are_named_exist(page):
    text = of_the_repository(page)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        file, _, section = link.partition("#")
        if not file.startswith("http"):
            target = page.parent / file if file else page
            assert target.exists() and (not section or section in anchors(target)), link
    if page in PAGES:
        for name in re.findall(r"`((?:slam|sim|scenarios|experiments|tests|examples|docs)/[\w./-]+)`", text):
            assert (ROOT / name).exists(), name


@pytest.mark.parametrize("page", SITE, ids=lambda page: page.name)
def test_what_is_made_is_what_would_be_made_now(page, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "docs"), *sys.path])
    made = importlib.import_module("generate").filled(page.read_text())
    assert made == page.read_text(), "run: python docs/generate.py --write"


@pytest.mark.parametrize("page", [*SITE, *(ROOT / name for name in WRAPPED)], ids=lambda page: page.name)
def test_no_line_is_long(page):
    assert [line for line in page.read_text().splitlines() if len(line) > 140] == []


def test_the_site_is_short():
    made = r"<!-- (?:made|code):.*?<!-- end -->"
    words = {p.name: len(re.sub(made, "", p.read_text(), flags=re.DOTALL).split()) for p in SITE}
    assert sum(words.values()) <= 22_000, words


def test_the_readme_is_short_and_shows_the_quickstart():
    readme = (ROOT / "README.md").read_text()
    assert len(readme.split()) <= 700
    (snippet,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    assert (ROOT / "examples" / "quickstart.py").read_text().endswith(snippet)


def test_what_is_to_be_cited_is_this_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert f"version = {{{version}}}" in (ROOT / "README.md").read_text()
