"""The package installs with plain pip, which knows no overrides."""

import tomllib
from importlib import resources
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def test_dependencies_need_no_overrides():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert not {"override-dependencies", "constraint-dependencies", "sources"} & set(project["tool"]["uv"])
    assert tomllib.loads((ROOT / "uv.lock").read_text()).get("manifest", {}).get("overrides") is None


def test_make_and_ci_never_install_system_packages():
    for name in ("Makefile", ".ci/run"):
        assert "apt-get" not in (ROOT / name).read_text()


@pytest.mark.parametrize("package", ["experiments", "scenarios", "sim", "slam"])
def test_every_package_declares_its_types(package):
    assert resources.files(package).joinpath("py.typed").is_file()
