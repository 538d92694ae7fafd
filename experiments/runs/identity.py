"""What a sequence and a system are, whatever name or place they have: digests of their content."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from dslab.experiments.runs.inputs import HashedFrames, array_digests
from dslab.experiments.runs.sources import is_recorded, open_sequence
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.registry import System, system_digest
from dslab.scenarios.errors import InputError
from dslab.scenarios.families import load_family
from dslab.scenarios.input_files import file_digest
from dslab.sim.cache import content_key
from dslab.sim.io.bag import is_bag
from dslab.sim.io.forms import sequence_folder
from dslab.sim.sequence import Sequence


def sequence_digest(source: str) -> str:
    """Hash of all that runs take from a sequence: equal for copies and spellings, new with any change.

    Of a folder these are the bytes of its images, or of all its files where the form names no images, of a
    bag the frames, with their times, the camera, the truth and the segments; of a scenario what is written in
    it.

    Args:
        source: a folder, a bag, the name of a scenario, or the path of its file.

    Raises:
        InputError: there is no such sequence, or it is not valid.
    """
    if not is_recorded(source):
        family = load_family(source)
        written = family.file.data if family.members else family.written
        return content_key(json.dumps(written, sort_keys=True, default=str))
    sequence = open_sequence(source)
    images = HashedFrames(sequence.frames).digest() if is_bag(source) else _files_digest(source, sequence)
    known = array_digests(sequence.stamps_s, sequence.T_world_cam, sequence.exposure_s)
    return content_key([images, *known, repr((sequence.camera, sequence.segments))])


def system_identity(system: System) -> str:
    """The source and the name in it of a class, however it was named; the name of any other system."""
    if not isinstance(system, ClassSystem):
        return system.name
    return f"{system_digest(system)}:{getattr(system.make, '__qualname__', system.name)}"


def check_once(where: str, identities: Mapping[str, str]) -> None:
    """Check that names stand for different things.

    Args:
        where: the names are given.
        identities: of what each name stands for.

    Raises:
        InputError: two of them are equal.
    """
    first: dict[str, str] = {}
    for name, identity in identities.items():
        if (other := first.setdefault(identity, name)) != name:
            raise InputError(where, f"{name} is the same as {other}", "name each once")


def _files_digest(source: str, sequence: Sequence) -> str:
    folder = sequence_folder(Path(source))
    names = sequence.image_names or sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))
    digest = hashlib.sha256()
    for name in names:
        with suppress(InputError):  # what cannot be read fails in its run
            digest.update(file_digest(folder / name))
    return digest.hexdigest()
