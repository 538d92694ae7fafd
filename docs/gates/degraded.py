"""Copies of recorded sequences as a worse camera would have taken them, for ``base-degraded.yaml``.

``python docs/gates/degraded.py OUT FOLDER...`` writes OUT/NAME-WHAT of every folder in TUM's form: at half
size, every second frame, blurred by 1 px, by JPEG at quality 30, with its noise doubled, 3840 px wide.
"""

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import yaml

SECONDS = 12.0
"""Of each sequence."""
WIDTH_4K = 3840
LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float64)


def noise_of(image: np.ndarray) -> float:
    """Standard deviation of an image's noise, grey levels.

    Source: Immerkær, "Fast noise variance estimation", 1996.
    """
    second = cv2.filter2D(image.astype(np.float64), -1, LAPLACIAN)[1:-1, 1:-1]
    return float(np.sqrt(np.pi / 2) * np.abs(second).mean() / 6)


def jpeg(image: np.ndarray, _: np.random.Generator) -> np.ndarray:
    """What is left of an image at quality 30."""
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 30])[1], cv2.IMREAD_GRAYSCALE)


def noisier(image: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """An image with twice its noise."""
    added = random.normal(0.0, np.sqrt(3.0) * noise_of(image), image.shape)
    return np.clip(np.rint(image + added), 0, 255).astype(np.uint8)


def scaled(image: np.ndarray, ratio: float) -> np.ndarray:
    """An image of another size; integers are pixel centres."""
    size = round(image.shape[1] * ratio), round(image.shape[0] * ratio)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA if ratio < 1 else cv2.INTER_CUBIC)


CHANGES = {
    "half": lambda image, _: scaled(image, 0.5),
    "second": lambda image, _: image,
    "blurred": lambda image, _: cv2.GaussianBlur(image, (0, 0), 1.0),
    "jpeg30": jpeg,
    "noise2": noisier,
    "4k": lambda image, _: scaled(image, WIDTH_4K / image.shape[1]),
}


def write(folder: Path, what: str, out: Path) -> None:
    """Write one changed copy."""
    rows = [
        line.split() for line in (folder / "rgb.txt").read_text().splitlines() if not line.startswith("#")
    ]
    rows = [row for row in rows if float(row[0]) <= float(rows[0][0]) + SECONDS][
        :: 2 if what == "second" else 1
    ]
    (out / "images").mkdir(parents=True)
    random, listed = np.random.default_rng(0), ["# timestamp filename"]
    for stamp, name in rows:
        image = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
        changed = CHANGES[what](image, random)
        cv2.imwrite(str(out / "images" / f"{Path(name).stem}.png"), changed, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        listed.append(f"{stamp} images/{Path(name).stem}.png")
    (out / "rgb.txt").write_text("\n".join(listed) + "\n")
    camera = yaml.safe_load((folder / "camera.yaml").read_text())
    across, down = changed.shape[1] / image.shape[1], changed.shape[0] / image.shape[0]
    camera |= {"fx": camera["fx"] * across, "cx": (camera["cx"] + 0.5) * across - 0.5}
    camera |= {"fy": camera["fy"] * down, "cy": (camera["cy"] + 0.5) * down - 0.5}
    camera |= {"width": changed.shape[1], "height": changed.shape[0]}
    camera["fps"] /= 2 if what == "second" else 1
    (out / "camera.yaml").write_text(yaml.safe_dump(camera, sort_keys=False))
    if (folder / "groundtruth.txt").exists():
        shutil.copy(folder / "groundtruth.txt", out)


if __name__ == "__main__":
    for folder in map(Path, sys.argv[2:]):
        for what in CHANGES:
            write(folder, what, Path(sys.argv[1]) / f"{folder.name}-{what}")
