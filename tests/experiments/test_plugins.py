"""Plugins are imported once per process, and one that fails is named."""

import sys

import pytest

from dslab.experiments.plugins import VARIABLE, load_plugins
from dslab.experiments.runs.systems.own_class import class_system
from dslab.scenarios.errors import InputError


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Makes a module the only plugin of a process that has loaded none."""

    def made(name, text):
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setenv(VARIABLE, name)
        load_plugins.cache_clear()

    yield made
    load_plugins.cache_clear()


def test_a_module_named_in_the_environment_is_imported(plugin, tmp_path):
    plugin("counting_plugin", f"open({str(tmp_path / 'seen')!r}, 'a').write('x')\n")
    assert load_plugins()[-1] == "counting_plugin" and load_plugins()[-1] == "counting_plugin"
    assert (tmp_path / "seen").read_text() == "x"


@pytest.mark.parametrize("name", ["plugin_of_here", "below/plugin_of_a_file.py"])
def test_a_plugin_is_found_in_the_present_folder_and_as_a_file(tmp_path, monkeypatch, name):
    path = tmp_path / name if name.endswith(".py") else tmp_path / f"{name}.py"
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"open({str(tmp_path / 'seen')!r}, 'a').write('x')\nOwn = int\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [part for part in sys.path if part])
    monkeypatch.setenv(VARIABLE, name)
    load_plugins.cache_clear()
    assert load_plugins()[-1] == name and class_system(f"{name}:Own").make is int
    load_plugins.cache_clear()
    assert (tmp_path / "seen").read_text() == "x"


@pytest.mark.parametrize(
    "text",
    ["raise RuntimeError('no good')", "raise SystemExit('no good')", "import os; os._exit(0) # no good"],
)
def test_a_plugin_that_fails_is_one_line(plugin, dslab, text):
    plugin("broken_plugin", text)
    with pytest.raises(InputError, match=r"DSLAB_PLUGINS: broken_plugin: cannot be loaded .*(good|_exit)"):
        load_plugins()
    code, _, err = dslab("scenarios", "list")
    assert code == 2 and "broken_plugin" in err and len(err.strip().splitlines()) == 1
