"""A frame of a recording: its image, and the features that the systems had in it."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from rerun.chunk import RrdReader

from dslab.experiments.recording.stream import part
from dslab.scenarios.errors import InputError

_POSITIONS, _BLOB = "Points2D:positions", "EncodedImage:blob"


@dataclass(frozen=True)
class RecordedFrame:
    """What a recording has of a frame.

    Attributes:
        frame: its number.
        image: (H, W) uint8.
        features, inliers: (n, 2) pixels of the image by system: those of the map, and all others.
    """

    frame: int
    image: np.ndarray
    features: dict[str, np.ndarray]
    inliers: dict[str, np.ndarray]


def recorded_frame(path: Path, systems: list[str], frame: int) -> RecordedFrame | None:
    """The recorded frame nearest to a frame; images are recorded ten times a second and at changes of state.

    Raises:
        InputError: it is no recording.
    """
    try:
        tables = [
            (chunk.entity_path, chunk.to_record_batch())
            for chunk in RrdReader(path).stream()
            if chunk.entity_path.startswith("/camera/") and not chunk.is_static
        ]
    except (OSError, RuntimeError, ValueError) as error:
        problem = f"is no recording that can be read ({' '.join(str(error).split())[:80]})"
        raise InputError(str(path), problem, "record it again") from None

    def values(entity: str, column: str) -> dict[int, np.ndarray]:
        """What an entity has in a column, by frame."""
        found = {}
        for name, table in tables:
            if name == entity and {"frame", column} <= set(table.schema.names):
                rows = zip(table["frame"].to_pylist(), table[column], strict=True)
                found |= {number: row.values for number, row in rows if row.is_valid}
        return found

    images = values("/camera/image", _BLOB)
    if not images:
        return None
    nearest = min(images, key=lambda number: (abs(number - frame), number))
    coded = np.asarray(images[nearest].flatten(), np.uint8)
    image = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(str(path), f"the image of frame {nearest} cannot be read", "record it again")

    def points(kind: str) -> dict[str, np.ndarray]:
        by_frame = {each: values(f"/camera/{part(each)}/{kind}", _POSITIONS) for each in systems}
        rows = {each: of[nearest] for each, of in by_frame.items() if nearest in of}
        # Pixel (0, 0) is a corner in rerun, here the centre of the first pixel.
        return {each: np.asarray(row.flatten(), float).reshape(-1, 2) - 0.5 for each, row in rows.items()}

    return RecordedFrame(nearest, np.asarray(image), points("features"), points("inliers"))
