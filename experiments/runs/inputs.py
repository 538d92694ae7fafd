"""What a run was given, as digests: runs of equal inputs are repeats of each other, whatever their names."""

import hashlib
from dataclasses import replace

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.sim.cache import content_key
from dslab.sim.sequence import FrameSource, Sequence


class HashedFrames:
    """Frames of another source, each hashed when it is first read."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._found: dict[int, bytes] = {}

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> np.ndarray:
        image = self._source[index]
        if index not in self._found:
            self._found[index] = hashlib.sha256(np.ascontiguousarray(image)).digest()
        return image

    def digest(self) -> str:
        """Hash of all frames; those that nobody has read are read, and one that cannot be read has none."""
        for index in range(len(self)):
            if index not in self._found:
                try:
                    self[index]
                except InputError:
                    self._found[index] = b""
        return hashlib.sha256(b"".join(self._found[index] for index in range(len(self)))).hexdigest()


def hashed(sequence: Sequence) -> Sequence:
    """The sequence, its frames hashed as they are read."""
    if isinstance(sequence.frames, HashedFrames):
        return sequence
    return replace(sequence, frames=HashedFrames(sequence.frames))


def input_digests(sequence: Sequence) -> dict[str, str]:
    """Hashes of all that a run takes from a sequence, and of the truth that it is judged by.

    Args:
        sequence: whole, before a system in real time has dropped frames; best of :func:`hashed`, before it
            is run, so that no frame is read twice.
    """
    frames = hashed(sequence).frames
    assert isinstance(frames, HashedFrames)
    return {
        "images": frames.digest()[:32],
        "times": content_key(array_digests(sequence.stamps_s, sequence.exposure_s)),
        "camera": content_key(repr(sequence.camera)),
        "truth": content_key(array_digests(sequence.T_world_cam)),
        "stress": content_key(repr(sequence.segments)),
    }


def array_digests(*arrays: np.ndarray | None) -> list[str | None]:
    """Hashes of the content of arrays, None of what is not known."""
    return [None if array is None else hashlib.sha256(array.tobytes()).hexdigest() for array in arrays]
