import os
import subprocess
import sys

import pytest

from dslab.scenarios.errors import InputError
from dslab.sim.rendering.gl_context import gl_info, shared_context


def test_info_describes_the_implementation():
    info = gl_info()
    assert info["backend"] in ("egl", "osmesa")
    assert all(info[key] for key in ("vendor", "renderer", "version"))


def test_a_process_has_one_context():
    assert shared_context() is shared_context()


def test_an_unknown_backend_is_bad_input(monkeypatch):
    monkeypatch.setenv("DSLAB_GL", "vulkan")
    with pytest.raises(InputError, match=r"DSLAB_GL.*egl, osmesa"):
        shared_context.__wrapped__()


def test_without_any_gl_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setenv("DSLAB_GL", "osmesa")
    monkeypatch.setenv("DSLAB_OSMESA_LIBRARY", "/nonexistent/libOSMesa.so")
    with pytest.raises(InputError) as error:
        shared_context.__wrapped__()
    assert "libegl1" in error.value.remedy
    assert f"pip --python {sys.executable} install" in error.value.remedy
    assert "\n" not in str(error.value)


def test_a_forced_mujoco_backend_is_overruled():
    # MuJoCo would otherwise import its own OSMesa wrapper, whose library may be absent.
    code = "from dslab.sim.rendering.gl_context import gl_info; import mujoco; print(gl_info()['backend'])"
    environment = {**os.environ, "MUJOCO_GL": "osmesa"}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == gl_info()["backend"]
