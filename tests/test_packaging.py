"""The package installs with plain pip, which knows no overrides."""

import re
import tomllib
from importlib import resources
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def test_dependencies_need_no_overrides():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert not {"override-dependencies", "constraint-dependencies", "sources"} & set(project["tool"]["uv"])
    assert tomllib.loads((ROOT / "uv.lock").read_text()).get("manifest", {}).get("overrides") is None


def test_make_never_installs_system_packages_and_ci_a_browser_at_most():
    assert "apt-get" not in (ROOT / "Makefile").read_text()
    assert re.findall(r"apt-get install [^>]*", (ROOT / ".ci/run").read_text()) == [
        "apt-get install -y -qq --no-install-recommends chromium "
    ]


@pytest.mark.parametrize("package", ["dslab.experiments", "dslab.scenarios", "dslab.sim", "dslab.slam"])
def test_every_package_declares_its_types(package):
    assert resources.files(package).joinpath("py.typed").is_file()
