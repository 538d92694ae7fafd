"""Families: scenarios whose fields may be distributions. A family and a seed give one scenario.

A family is a scenario's YAML file in which any node may be a distribution (``scenarios.distributions``).
It may have ``members``, a mapping of an id to that member's own fields; ``name/id`` is then a family too, and
for the bare name the seed selects a member.

Every distribution has its own stream, named by its place, so that a new one changes no other. Numbers drawn
for a whole-numbered field are rounded, which gives the two ends of a ``uniform`` half the weight of the rest;
``choice`` gives every number the same.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from scenarios.distributions import Choice, Distribution, NotationError, is_distribution, parse_distribution
from scenarios.drawing import Draw
from scenarios.errors import InputError
from scenarios.faults import first_fault, guess
from scenarios.input_files import is_given
from scenarios.seeds import rng_for
from scenarios.spec import Scenario
from scenarios.yaml_file import Location, YamlFile, field_path, read_yaml

LIBRARY_DIR = Path(__file__).parent / "library"
MEMBERS = "members"
SEED_END = 2**63
_SUFFIXES = (".yaml", ".yml")
_MEMBER_ID = re.compile(r"[a-z0-9][a-z0-9_-]*")
# Fields that cannot be drawn.
_FIXED = ("spec_version", "name", "description", "seed")


@dataclass(frozen=True, eq=False)
class Family:
    """Scenarios that differ only in drawn values.

    Attributes:
        name: ``family`` or ``family/member``.
        description: for people.
        members: their ids; empty if the family has none or is itself a member.
        parameters: every distribution, by its place in the family; of a choice's option ``a.choice[1].b``.
        seed: the default seed.
        written: the fields as written, with a member's own over those of its family.
        file: their file.
        member_id: the member's id, if it is one.
    """

    name: str
    description: str
    members: tuple[str, ...]
    parameters: dict[str, Distribution]
    seed: int
    written: dict[str, Any] = field(repr=False)
    file: YamlFile = field(repr=False)
    member_id: str | None = None

    def member(self, member_id: str) -> "Family":
        """One member as a family.

        Raises:
            InputError: the member does not exist.
        """
        if member_id not in self.members:
            known = list(self.members)
            remedy = f"use {guess(member_id, known)}one of {', '.join(known)}" if known else "leave it out"
            raise InputError(f"{self.name}/{member_id}", f"{self.name} has no such member", remedy)
        return _family(self.file, member_id)

    def sample(self, seed: int) -> Scenario:
        """Draw the scenario of a seed, which becomes the scenario's own seed.

        Args:
            seed: at least 0; the streams are ``("family", place)``.

        Raises:
            InputError: the draw is no valid scenario, or the seed is negative.
        """
        if not 0 <= seed < SEED_END:
            raise InputError(
                f"seed {seed}", "is out of range", f"use a whole number from 0 to {SEED_END - 1}"
            )
        if self.members:
            drawn = rng_for(seed, "family", MEMBERS).random()
            return self.member(self.members[int(drawn * len(self.members))]).sample(seed)
        draw = Draw(seed)
        data = {key: draw(value, (key,), (key,)) for key, value in self.written.items()}
        draw.round_whole_numbers(data)
        try:
            return Scenario.model_validate({**data, "seed": seed})
        except ValidationError as error:
            of_sample = f", in {self.name} as drawn with seed {seed}" if self.parameters else ""
            raise first_fault(
                error,
                lambda at: _where(self.file, self.member_id, draw.written_at(at), at),
                of_sample,
                (MEMBERS,),
            ) from None

    def as_yaml(self) -> str:
        """The family with its distributions, as YAML that ``load_family`` reads back."""
        if self.member_id is None:
            return self.file.text
        return yaml.dump(self.written, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True)


class _PlainDumper(yaml.SafeDumper):
    """Dumper that writes repeated parts in full, without YAML anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def family_names() -> list[str]:
    """The families that come with the package, sorted; those with members as ``family/member``."""
    names = []
    for name, path in _library().items():
        members = load_family(path).members
        names += [f"{name}/{member}" for member in members] if members else [name]
    return names


def library_names() -> list[str]:
    """The families that come with the package, sorted, those with members by their bare names."""
    return list(_library())


def is_scenario_name(text: str) -> bool:
    """Return True if a text looks like a family, a member or a YAML file."""
    path = Path(text)
    return text.partition("/")[0] in _library() or path.suffix in _SUFFIXES or path.parent.suffix in _SUFFIXES


def load_family(path_or_name: str | Path) -> Family:
    """Load a family by name or YAML file, or a member as ``family/member``.

    A member of a file is ``file.yaml/member``. The notation is checked; drawn scenarios are validated when
    sampled.

    Raises:
        InputError: unknown name or member, missing file, no YAML, or an invalid distribution.
    """
    text, path = str(path_or_name), Path(path_or_name)
    head, _, member = text.partition("/")
    if head in _library() and path.suffix not in _SUFFIXES:
        family = _library_family(head)
        return family.member(member) if member else family
    if path.suffix not in _SUFFIXES and path.parent.suffix in _SUFFIXES:
        return load_family_file(path.parent).member(path.name)
    if path.suffix in _SUFFIXES or is_given(path):
        return load_family_file(path)
    likely = guess(text, [*_library(), *family_names()])
    raise InputError(
        text, "no such scenario", f"use {likely}one of {', '.join(_library())}, or the path of a .yaml file"
    )


def load_family_file(path: Path) -> Family:
    """A family from one YAML file. Raises InputError as ``load_family`` does."""
    return _family(read_yaml(path))


@cache
def _library() -> dict[str, Path]:
    return {path.stem: path for path in sorted(LIBRARY_DIR.glob("*.yaml"), key=lambda path: path.stem)}


@cache
def _library_family(name: str) -> Family:
    return load_family_file(_library()[name])


def _family(file: YamlFile, member_id: str | None = None) -> Family:
    """A family from its file, or one member of it."""
    own = {key: value for key, value in file.data.items() if key != MEMBERS}
    if member_id is None:
        members = _members(file)
        name = str(own.get("name", file.path.stem))
    else:
        members = ()
        name = f"{own.get('name', file.path.stem)}/{member_id}"
        own = {**merged(own, file.data[MEMBERS][member_id] or {}), "name": name}

    def where(at: Location) -> str:
        return _where(file, member_id, at, at)

    for key in _FIXED:
        if is_distribution(own.get(key)):
            raise InputError(where((key,)), "cannot be drawn", "give one value")
    parameters = {
        field_path(at): found
        for key, value in own.items()
        for at, found in distributions_in(value, (key,), where)
    }
    description = str(own.get("description", ""))
    return Family(name, description, members, parameters, _seed(own, where), own, file, member_id)


def _members(file: YamlFile) -> tuple[str, ...]:
    if MEMBERS not in file.data:
        return ()
    members = file.data[MEMBERS]
    if not isinstance(members, dict) or not members:
        raise InputError(file.where((MEMBERS,)), "holds no members", "map each id to its own fields")
    for member_id, overrides in members.items():
        at: Location = (MEMBERS, str(member_id))
        if not isinstance(member_id, str):
            problem = f"has an id that is no text, {member_id!r}"
            raise InputError(file.where((MEMBERS,)), problem, 'put ids in quotes, for example "00"')
        if not _MEMBER_ID.fullmatch(member_id):
            raise InputError(file.where(at), "is no id", "use small letters, digits, - and _")
        if not isinstance(overrides, dict | None):
            raise InputError(file.where(at), "is no mapping", "give the fields that differ")
        if "name" in (overrides or {}):
            raise InputError(file.where((*at, "name")), "is given by the member's id", "leave it out")
    return tuple(members)


def merged(base: dict[Any, Any], over: dict[Any, Any]) -> dict[Any, Any]:
    """Merge mappings key by key; other values and mappings of another kind replace."""
    result = dict(base)
    for key, value in over.items():
        before = base.get(key, {})
        alike = _is_plain_mapping(before) and _is_plain_mapping(value)
        if alike and ("kind" not in value or value["kind"] == before.get("kind")):
            result[key] = merged(before, value)
        else:
            result[key] = value
    return result


def _is_plain_mapping(node: Any) -> bool:
    return isinstance(node, dict) and not is_distribution(node)


def distributions_in(
    node: Any, at: Location, where: Callable[[Location], str]
) -> Iterator[tuple[Location, Distribution]]:
    """Yield every distribution in a node with its place."""
    if is_distribution(node):
        try:
            found = parse_distribution(node)
        except NotationError as error:
            raise InputError(where(at), error.problem, error.remedy) from None
        yield at, found
        node, at = (node["choice"], (*at, "choice")) if isinstance(found, Choice) else (None, at)
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in inner:
        yield from distributions_in(value, (*at, key), where)


def _seed(written: dict[str, Any], where: Callable[[Location], str]) -> int:
    seed = written.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < SEED_END:
        raise InputError(where(("seed",)), f"{seed!r} is not valid", "give a whole number from 0")
    return seed


def _where(file: YamlFile, member_id: str | None, written: Location, field: Location) -> str:
    """File, line and name of a field of a member or of its family."""
    if member_id is not None:
        own: Location = (MEMBERS, member_id, *written)
        if file.depth(own) - 2 >= file.depth(written):
            written = own
    return file.where(written, field)
