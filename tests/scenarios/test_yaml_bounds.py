"""YAML of bounded size and depth, checked before anything is made of it."""

import time

import pytest

from dslab.scenarios.errors import InputError
from dslab.scenarios.loading import load_scenario
from dslab.scenarios.yaml_file import read_yaml

PLAIN = "name: plain\nworld: {kind: room}\n"


def bomb(levels: int = 9) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, levels)]
    return "\n".join(lines) + "\n"


def ladder(steps: int) -> str:
    """Aliases, each one level above the last."""
    return "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}]\n" for n in range(1, steps))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (bomb(), "holds more than 20000 parts"),
        ("x: [" + "a, " * 30_000 + "a]", "holds more than 20000 parts"),
        ("description: &a [*a]", ":3: *a stands for a part of itself"),
        ("description: &a {b: {c: *a}}", ":3: *a stands for a part of itself"),
        ("description: " + "[" * 400 + "]" * 400, "nested more than 40 deep"),
        (
            "description:" + "".join("\n" + "  " * n + "- a:" for n in range(1, 100)),
            "nested more than 40 deep",
        ),
        ("description: " + "[" * 400_000, "nested more than 40 deep"),
        (ladder(50), "nested more than 40 deep"),
        ("m: &m {a: 1}\nseed: *n", "undefined alias"),
        ("seed: " + "9" * 401, ":3: seed: is a whole number of more than 64 bits"),
        ("seed: 0x" + "f" * 9999, ":3: seed: is a whole number of more than 64 bits"),
        ("duration_s: .inf", ":3: duration_s: is not a finite number"),
        ("camera: {fps: .nan}", ":3: camera.fps: is not a finite number"),
        ("seed: 1\nseed: 1", ":4: seed: key appears twice"),
        ("description: !!binary aGk=", "tag:yaml.org,2002:binary"),
        ("description: !!set {a}", "tag:yaml.org,2002:set"),
        ("description: " + "x" * 3_000_000, "more than the 2 MB"),
    ],
    ids=range(17),
)
def test_what_would_hang_or_overflow_is_one_line_at_once(tmp_path, text, problem):
    (tmp_path / "mine.yaml").write_text(PLAIN + text)
    started_s = time.monotonic()
    with pytest.raises(InputError) as caught:
        load_scenario(tmp_path / "mine.yaml")
    assert problem in str(caught.value) and "\n" not in str(caught.value)
    assert time.monotonic() - started_s < 5


def test_aliases_within_bounds_are_what_they_stand_for(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(bomb(3) + "base: &b {k: 1, l: 2}\nover: {<<: *b, l: 3}\n" + ladder(30).replace("a", "b"))
    data = read_yaml(path).data
    assert data["a2"][8][8] == ["x"] * 9 and data["over"] == {"k": 1, "l": 3}


def test_a_date_is_text(tmp_path):
    (tmp_path / "mine.yaml").write_text("begun: 2001-01-01\nof: {2001-01-02: 1}\n")
    assert read_yaml(tmp_path / "mine.yaml").data == {"begun": "2001-01-01", "of": {"2001-01-02": 1}}


def test_opencv_s_first_line_is_skipped(tmp_path):
    (tmp_path / "mine.yaml").write_text("%YAML:1.0\n---\n" + PLAIN)
    assert load_scenario(tmp_path / "mine.yaml").name == "plain"
