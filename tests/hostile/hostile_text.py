"""Changes of tables, which are lines of words, and of trees, which are YAML and JSON."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from hostile_changes import DIGITS, NUMBERS, UNLESS_SPARSE, Change, Strict
from hypothesis import strategies as st

_TOKEN = "HOSTILE0TOKEN"
_NESTED = "[" * 400 + "]" * 400
_BOMB = "{a0: &a0 [x, x, x, x, x, x, x, x, x, x], " + ", ".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10)
) + "}"  # fmt: skip
_WORDS = ("abc", "[1]", "true", "nan", "inf", "1e400", DIGITS, "0x10", "1_0", "\u0661", "--1", "1;2", '"1"')
_TEXTS = ('"[/]"', '"\\ud800"', '"\\u001b[31m"', '"../../x"', '"a\\nb"')
_YAML = (
    "abc", "''", "[1]", "{a: 1}", "true", ".nan", ".inf", DIGITS, _NESTED, "2001-01-01", "!!binary aGk=",
    "!!python/object/apply:os.getcwd []", "&a [*a]", "&a {b: *a}", "!!set {1}", "&b 1\n<<: *b",
)  # fmt: skip
_JSON = (
    '"abc"', '""', "[1]", '{"a": 1}', "true", "NaN", "Infinity", DIGITS, _NESTED,
    "[" * 100_000 + "]" * 100_000, '"\\ud800"', '"\\u0000"',
)  # fmt: skip


def table(draw: Any, path: Path) -> Change:
    lines = path.read_text().splitlines()
    separator = "," if path.suffix == ".csv" else " "
    filled = [n for n, line in enumerate(lines) if line.strip() and line[0] != "#"]
    if not filled:
        return "a line of words", False, lambda path: path.write_text("a b\n")
    rows = st.sampled_from(filled)
    row, other = draw(rows), draw(rows)
    words = lines[row].split(separator)
    at = draw(st.integers(0, len(words) - 1))
    word, figure = draw(st.sampled_from(_WORDS)), draw(st.sampled_from(NUMBERS))
    swapped = list(lines)
    swapped[row], swapped[other] = lines[other], lines[row]

    def of_words(changed: list[str]) -> list[str]:
        return [*lines[:row], separator.join(changed), *lines[row + 1 :]]

    changes = {
        f"lines {row} and {other} swapped": (True, swapped),
        f"line {row} removed": (UNLESS_SPARSE, lines[:row] + lines[row + 1 :]),
        f"line {row} doubled": (True, lines[: row + 1] + lines[row:]),
        "lines reversed": (True, lines[::-1]),
        # Of true poses, nan means that there is none.
        f"line {row}: word {at} is {word[:40]!r}": (
            UNLESS_SPARSE if word == "nan" else True,
            of_words([*words[:at], word, *words[at + 1 :]]),
        ),
        f"line {row}: word {at} is {figure}": (False, of_words([*words[:at], figure, *words[at + 1 :]])),
        f"line {row}: word {at} removed": (True, of_words(words[:at] + words[at + 1 :])),
        f"line {row}: word {at} doubled": (True, of_words(words[: at + 1] + words[at:])),
    }
    what = draw(st.sampled_from(list(changes)))
    strict, changed = changes[what]
    return what, strict, lambda path: path.write_text("\n".join(changed) + "\n")


def tree(draw: Any, path: Path) -> Change:
    is_json = path.suffix == ".json"
    text = path.read_text()
    content = json.loads(text) if is_json else yaml.safe_load(text.replace("%YAML:1.0", ""))
    places = [place for place in _places(content) if place]
    if not places:
        return "is 1", True, lambda path: path.write_text("1")
    place = draw(st.sampled_from(places))
    parent, key = _at(content, place[:-1]), place[-1]
    raws = _JSON if is_json else _YAML
    raw = draw(st.sampled_from([raw for raw in raws if not _alike(raw, parent[key])]))
    figure, whole = draw(st.sampled_from((*NUMBERS, *_TEXTS))), draw(st.sampled_from(raws))
    # The key that is set, its value, and the text that stands for the token.
    changes: dict[str, tuple[Strict, Any, Any, str]] = {
        f"is {raw[:40]!r}": (True, key, _TOKEN, raw),
        f"is {figure}": (False, key, _TOKEN, figure),
        "is null": (False, key, _TOKEN, "null"),
        f"and all the rest are {whole[:40]!r}": (True, None, None, whole),
    }
    if isinstance(parent, dict):
        changes |= {
            "is twice": (True, _TOKEN, parent[key], json.dumps(key)),
            "is twice, once 1": (True, _TOKEN, 1, json.dumps(key)),
            "has an unknown key beside it": (True, _TOKEN, 1, '"hostile"'),
            "is missing": (UNLESS_SPARSE, _TOKEN, 1, ""),
        }
    if not is_json:
        changes["is a bomb of aliases"] = (True, key, _TOKEN, _BOMB)
    first = next(iter(changes))
    what = draw(st.sampled_from([first, first, *changes]))
    strict, at, value, raw = changes[what]
    if at is None:
        changed = raw
    else:
        parent[at] = value
        if not raw:
            del parent[at], parent[key]
        changed = json.dumps(content, indent=1) if is_json else yaml.safe_dump(content, sort_keys=False)
        changed = changed.replace(f'"{_TOKEN}"' if is_json else _TOKEN, raw)
    return f"{'.'.join(map(str, place))} {what}", strict, lambda path: path.write_text(changed)


def _places(content: Any, place: tuple = ()) -> Iterator[tuple]:
    yield place
    if isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield from _places(value, (*place, key))


def _at(content: Any, place: tuple) -> Any:
    for key in place:
        content = content[key]
    return content


def _alike(raw: str, value: Any) -> bool:
    """The text is of the same type as the value, so that it is another value and no other type."""
    kinds = {"abc": str, "''": str, '"': str, "[": list, "{": dict, "true": bool}
    kind = next((kind for start, kind in kinds.items() if raw.startswith(start)), None)
    return kind is not None and (isinstance(value, kind) or value is None)
