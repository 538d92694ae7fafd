"""YAML files with the lines of their parts, for the place of every fault."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dslab.scenarios.errors import InputError, collect
from dslab.scenarios.input_files import SETTINGS_BYTES, number_fault, read_text

Location = tuple[str | int, ...]
"""Keys and indices from the root to a part."""

_MERGE = "<<"
_OPENCV = re.compile(r"^%YAML:.*$|!!opencv-matrix", re.MULTILINE)
_MOST_PARTS, _MOST_DEPTH = 20_000, 40


class _Loader(yaml.SafeLoader):
    """Makes what JSON can hold: a date is text, bytes and sets are refused."""

    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, fits) for tag, fits in those if not tag.endswith(":timestamp")]
        for first, those in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    yaml_constructors = {  # noqa: RUF012
        tag: make
        for tag, make in yaml.SafeLoader.yaml_constructors.items()
        if str(tag).rpartition(":")[2] not in ("timestamp", "binary", "set", "omap", "pairs")
    }


@dataclass(frozen=True, eq=False)
class YamlFile:
    """A file that holds one mapping.

    Attributes:
        path: of the file.
        text: its content.
        data: the mapping.
        root: its nodes, with their lines.
    """

    path: Path
    text: str
    data: dict[Any, Any]
    root: yaml.Node

    def where(self, location: Location, field: Location | None = None) -> str:
        """``file:line: field.path`` of the innermost part that the file has.

        Args:
            location: of the part in the file.
            field: name of the part, if not its path in the file.
        """
        line = _reach(self.root, location)[0].start_mark.line + 1
        name = field_path(location if field is None else field)
        return f"{self.path}:{line}: {name}" if name else str(self.path)

    def depth(self, location: Location) -> int:
        """Number of leading parts of the location that the file has."""
        return _reach(self.root, location)[1]


def field_path(location: Location) -> str:
    """Format a location: ``segments[0].contrast``."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).lstrip(".")


def read_yaml(
    path: Path,
    holds: str = "scenario",
    example: str = "`dslab scenarios show clean-room`",
    if_missing: str | None = None,
    faults: list[InputError] | None = None,
) -> YamlFile:
    """Read one file.

    Args:
        path: of the file; OpenCV's line ``%YAML:1.0`` and its tags of matrices are skipped.
        holds: its expected content, for the fault.
        example: source of an example, for the fault.
        if_missing: advice if there is no such file; None for the example.
        faults: gets the keys given twice and the numbers that are not finite; None to raise them.

    Raises:
        InputError: the file cannot be read, is no YAML, has too many or too deeply nested parts, holds no
            mapping, has a key twice, or a number that is not finite.
    """
    text = read_text(path, SETTINGS_BYTES, if_missing or f"check the path, or start from {example}")
    plain = _OPENCV.sub("", text)
    try:
        _check_bounds(path, plain)
        root = yaml.compose(plain, Loader=_Loader)
        data = yaml.load(plain, Loader=_Loader)
    except yaml.YAMLError as error:
        raise _not_yaml(path, error) from None
    except ValueError as error:
        raise InputError(str(path), f"is not valid YAML ({error})", "correct the value") from None
    if not isinstance(data, dict) or root is None:
        raise InputError(str(path), f"holds no {holds}", f"start from {example}")
    file = YamlFile(path, text, data, root)
    places = [
        f"{path}:{key.start_mark.line + 1}: {field_path(location)}" for location, key in _duplicate_keys(root)
    ]
    found = [InputError(where, "key appears twice", "keep one of them") for where in places]
    found += [
        InputError(file.where(location), fault, "correct it")
        for location, value in _leaves(data)
        if (fault := number_fault(value))
    ]
    collect(found, faults)
    return file


def _check_bounds(path: Path, text: str) -> None:
    """Raise InputError for too many or too deeply nested parts, before any is made.

    What an alias stands for is counted at each place where it stands.
    """
    # Of every open part its anchor, the parts before it and the levels below it.
    opened: list[tuple[str | None, int, int]] = []
    anchored: dict[str, tuple[int, int]] = {}
    parts = 0
    for event in yaml.parse(text, Loader=_Loader):
        where = f"{path}:{event.start_mark.line + 1}"
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _, _ in opened):
                raise InputError(where, f"*{event.anchor} stands for a part of itself", "write it out")
            count, levels = anchored.get(event.anchor, (1, 1))
        elif isinstance(event, yaml.ScalarEvent):
            count, levels = 1, 1
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, parts, 1))
            count, levels = 1, 0
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before, levels = opened.pop()
            count = 0
            if anchor is not None:
                anchored[anchor] = (parts - before, levels)
        else:
            continue
        parts += count
        if opened:
            anchor, before, deepest = opened[-1]
            opened[-1] = (anchor, before, max(deepest, levels + 1))
        if parts > _MOST_PARTS:
            raise InputError(where, f"holds more than {_MOST_PARTS} parts", "write a shorter file")
        if len(opened) + levels > _MOST_DEPTH:
            raise InputError(where, f"is nested more than {_MOST_DEPTH} deep", "write a flatter file")


def _leaves(data: Any, location: Location = ()) -> Iterator[tuple[Location, Any]]:
    """Yield the location and value of everything that is no mapping or list."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _leaves(value, (*location, key))
    else:
        yield location, data


def _not_yaml(path: Path, error: yaml.YAMLError) -> InputError:
    mark = getattr(error, "problem_mark", None)
    where = f"{path}:{mark.line + 1}" if mark else str(path)
    problem = getattr(error, "problem", None) or "cannot be parsed"
    return InputError(where, f"is not valid YAML ({problem})", "correct the syntax")


def _reach(root: yaml.Node, location: Location) -> tuple[yaml.Node, int]:
    """The innermost existing node on a path (of a mapping's entry the key), and its depth."""
    at = value = root
    for gone, part in enumerate(location):
        if isinstance(value, yaml.MappingNode):
            found = _entry(value, part)
        elif isinstance(value, yaml.SequenceNode) and isinstance(part, int) and part < len(value.value):
            found = (value.value[part], value.value[part])
        else:
            found = None
        if found is None:
            return at, gone
        at, value = found
    return at, len(location)


def _entry(mapping: yaml.MappingNode, key: str | int) -> tuple[yaml.Node, yaml.Node] | None:
    """Key and value of an entry, its own or one merged by ``<<``."""
    own = next(((k, v) for k, v in mapping.value if k.value == str(key)), None)
    if own is not None:
        return own
    for k, v in mapping.value:
        if k.value == _MERGE:
            for merged in v.value if isinstance(v, yaml.SequenceNode) else [v]:
                found = _entry(merged, key) if isinstance(merged, yaml.MappingNode) else None
                if found is not None:
                    return found
    return None


def _duplicate_keys(node: yaml.Node, location: Location = ()) -> Iterator[tuple[Location, yaml.Node]]:
    """Yield keys that would silently replace an earlier one of the same name."""
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            name = str(key.value)
            if name in seen:
                yield (*location, name), key
            seen.add(name)
            yield from _duplicate_keys(value, (*location, name))
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            yield from _duplicate_keys(value, (*location, index))
