"""Families: scenarios whose fields may be distributions. A family and a seed give one scenario.

A family is a scenario's YAML file in which any node may be a distribution (``scenarios.distributions``).
It may have ``members``, a mapping of an id to that member's own fields; ``name/id`` is then a family too, and
for the bare name the seed selects a member.

Every distribution has its own stream, named by its place, so that a new one changes no other. Numbers drawn
for a whole-numbered field are rounded, which gives the two ends of a ``uniform`` half the weight of the rest;
``choice`` gives every number the same.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache, reduce
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from dslab.scenarios.distributions import (
    Choice,
    Distribution,
    NotationError,
    is_distribution,
    parse_distribution,
)
from dslab.scenarios.drawing import Draw
from dslab.scenarios.errors import InputError, collect
from dslab.scenarios.faults import all_faults, guess
from dslab.scenarios.input_files import is_given
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Scenario
from dslab.scenarios.yaml_file import Location, YamlFile, field_path, read_yaml

LIBRARY_DIR = Path(__file__).parent / "library"
MEMBERS = "members"
SEED_END = 2**63
_SUFFIXES = (".yaml", ".yml")
_MEMBER_ID = re.compile(r"[a-z0-9][a-z0-9_-]*")
# Fields that cannot be drawn.
_FIXED = ("name", "description", "seed")


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
            raise all_faults(
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


def file_faults(path: Path, seeds: int) -> list[InputError]:
    """Every fault of a scenario file, in the order of its lines.

    Args:
        path: a YAML file.
        seeds: number of seeds with which each member is drawn.

    Raises:
        InputError: it cannot be read as YAML.
    """
    faults: list[InputError] = []
    file = read_yaml(path, faults=faults)
    family = _family(file, None, faults)
    for one in [_family(file, member, faults) for member in family.members] or [family]:
        for seed in range(one.seed, one.seed + (seeds if one.parameters else 1)):
            try:
                one.sample(seed)
            except InputError as error:
                faults += error.faults
    return in_order_of_lines(path, faults)


def in_order_of_lines(path: Path, faults: Iterable[InputError]) -> list[InputError]:
    """The faults of a file by line, of each place the first."""
    by_place: dict[str, InputError] = {}
    for fault in faults:
        by_place.setdefault(fault.where, fault)

    def line(fault: InputError) -> int:
        found = re.match(r":(\d+)", fault.where.removeprefix(str(path)))
        return int(found[1]) if found else 0

    return sorted(by_place.values(), key=line)


@cache
def _library() -> dict[str, Path]:
    return {path.stem: path for path in sorted(LIBRARY_DIR.glob("*.yaml"), key=lambda path: path.stem)}


@cache
def _library_family(name: str) -> Family:
    return load_family_file(_library()[name])


def _family(file: YamlFile, member_id: str | None = None, faults: list[InputError] | None = None) -> Family:
    """A family from its file, or one member of it.

    Args:
        file: of the family.
        member_id: of the member.
        faults: gets what is wrong, the family is then one without it; None to raise it.
    """
    own = {key: value for key, value in file.data.items() if key != MEMBERS}
    if member_id is None:
        members = _members(file, faults)
        name = str(own.get("name", file.path.stem))
    else:
        members = ()
        name = f"{own.get('name', file.path.stem)}/{member_id}"
        own = {**merged(own, file.data[MEMBERS][member_id] or {}), "name": name}

    def where(at: Location) -> str:
        return _where(file, member_id, at, at)

    wrong: dict[Location, InputError] = {
        (key,): InputError(where((key,)), "cannot be drawn", "give one value")
        for key in _FIXED
        if is_distribution(own.get(key))
    }
    parameters = {}
    for at, found in distributions_in({key: own[key] for key in own if (key,) not in wrong}, ()):
        if isinstance(found, NotationError):
            wrong[at] = InputError(where(at), found.problem, found.remedy)
        else:
            parameters[field_path(at)] = found
    if ("seed",) not in wrong and (fault := _seed_fault(own, where)):
        wrong[("seed",)] = fault
    collect(list(wrong.values()), faults)
    own = _without(own, wrong)
    description, seed = str(own.get("description", "")), own.get("seed") or 0
    return Family(name, description, members, parameters, seed, own, file, member_id)


def _without(data: dict[Any, Any], places: Iterable[Location]) -> dict[Any, Any]:
    """The data with nothing at some places."""
    places = list(places)
    if places:
        data = deepcopy(data)
    for place in places:
        holder: Any = reduce(lambda part, key: part[key], place[:-1], data)
        holder[place[-1]] = None
    return data


def _members(file: YamlFile, faults: list[InputError] | None) -> tuple[str, ...]:
    if MEMBERS not in file.data:
        return ()
    members = file.data[MEMBERS]
    if not isinstance(members, dict) or not members:
        fault = InputError(file.where((MEMBERS,)), "holds no members", "map each id to its own fields")
        collect([fault], faults)
        return ()
    wrong = {
        member_id: fault
        for member_id, overrides in members.items()
        if (fault := _member_fault(file, member_id, overrides))
    }
    collect(list(wrong.values()), faults)
    return tuple(member_id for member_id in members if member_id not in wrong)


def _member_fault(file: YamlFile, member_id: Any, overrides: Any) -> InputError | None:
    at: Location = (MEMBERS, str(member_id))
    if not isinstance(member_id, str):
        problem = f"has an id that is no text, {member_id!r}"
        return InputError(file.where((MEMBERS,)), problem, 'put ids in quotes, for example "00"')
    if not _MEMBER_ID.fullmatch(member_id):
        return InputError(file.where(at), "is no id", "use small letters, digits, - and _")
    if not isinstance(overrides, dict | None):
        return InputError(file.where(at), "is no mapping", "give the fields that differ")
    if "name" in (overrides or {}):
        return InputError(file.where((*at, "name")), "is given by the member's id", "leave it out")
    return None


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


def distributions_in(node: Any, at: Location) -> Iterator[tuple[Location, Distribution | NotationError]]:
    """Yield every distribution in a node with its place, or the fault of one that is not written as one."""
    if is_distribution(node):
        try:
            found = parse_distribution(node)
        except NotationError as error:
            found = error
        yield at, found
        node, at = (node["choice"], (*at, "choice")) if isinstance(found, Choice) else (None, at)
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in inner:
        yield from distributions_in(value, (*at, key))


def _seed_fault(written: dict[str, Any], where: Callable[[Location], str]) -> InputError | None:
    seed = written.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < SEED_END:
        return InputError(where(("seed",)), f"{seed!r} is not valid", "give a whole number from 0")
    return None


def _where(file: YamlFile, member_id: str | None, written: Location, field: Location) -> str:
    """File, line and name of a field of a member or of its family."""
    if member_id is not None:
        own: Location = (MEMBERS, member_id, *written)
        if file.depth(own) - 2 >= file.depth(written):
            written = own
    return file.where(written, field)
