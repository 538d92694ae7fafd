"""Texture primitives: noise at every scale, dead leaves, text, and level fitting.

Every function draws into a gray image (h, w) uint8 in place or returns one; ``scale`` is pixels per metre.
Features at every distance need detail at every scale, hence 1/f spectra and power-law sizes throughout.
"""

import cv2
import numpy as np

BLACK_LEVEL, WHITE_LEVEL = 6, 249
_FULL_TURN_DEG = 360.0


def fractal_noise(shape: tuple[int, int], rng: np.random.Generator, persistence: float = 0.7) -> np.ndarray:
    """Noise with a power-law spectrum, zero mean, unit standard deviation.

    Half of every octave's energy is Gaussian, half is in sparse blobs, which give corners.

    Args:
        shape: (h, w).
        rng: the random stream.
        persistence: amplitude of an octave relative to the one half as fine; 1 is white-ish, 0.5 smooth.

    Returns:
        (h, w) float32.
    """
    octaves = max(1, int(np.log2(max(2, min(shape)))) - 1)
    sizes = [tuple(max(1, side >> k) for side in shape) for k in range(octaves, -1, -1)]
    field = np.zeros(sizes[0], np.float32)
    amplitude = 1.0
    for size in sizes:
        field = cv2.resize(field, size[::-1], interpolation=cv2.INTER_LINEAR)
        field += amplitude * _octave(size, rng)
        amplitude *= persistence
    mean, deviation = cv2.meanStdDev(field)
    return (field - np.float32(mean[0, 0])) * np.float32(1 / max(deviation[0, 0], 1e-6))


def _octave(size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """One octave: bytes mapped by a table to a dense and a heavy-tailed part."""
    codes = np.frombuffer(rng.bytes(size[0] * size[1]), np.uint8).reshape(size)
    return cv2.LUT(codes, _OCTAVE_TABLE)


def _octave_table() -> np.ndarray:
    table = np.linspace(-1.0, 1.0, 256, dtype=np.float32)
    table[:6], table[-6:] = -6.0, 6.0
    return table


_OCTAVE_TABLE = _octave_table()


def add_noise(image: np.ndarray, rng: np.random.Generator, levels: float, persistence: float = 0.7) -> None:
    """Add fractal noise of standard deviation ``levels`` gray levels in place."""
    noise = fractal_noise(image.shape, rng, persistence) * np.float32(levels)
    cv2.add(image, noise, dst=image, dtype=cv2.CV_8U)


def grain(image: np.ndarray, rng: np.random.Generator, levels: float, vertical: bool) -> None:
    """Add wood grain in place: noise of ``levels`` gray levels, stretched along one direction."""
    height, width = image.shape
    shape = (max(2, height // 24), width) if vertical else (height, max(2, width // 24))
    noise = fractal_noise(shape, rng, 0.9) * np.float32(levels)
    cv2.add(image, cv2.resize(noise, (width, height)), dst=image, dtype=cv2.CV_8U)


def multiply(image: np.ndarray, gain: np.ndarray) -> None:
    """Multiply in place by a coarse gain image, stretched to the full size."""
    full = cv2.resize(gain.astype(np.float32), image.shape[::-1], interpolation=cv2.INTER_LINEAR)
    cv2.multiply(image, full, dst=image, dtype=cv2.CV_8U)


def shade(image: np.ndarray, factor: float) -> None:
    """Multiply in place by one factor."""
    if image.size:
        cv2.multiply(image, np.full(image.shape, factor), dst=image, dtype=cv2.CV_8U)


def dead_leaves(
    image: np.ndarray,
    scale: float,
    rng: np.random.Generator,
    per_m2: float,
    size_m: tuple[float, float],
    levels: tuple[int, int] = (20, 235),
    smallest_px: float = 0.0,
) -> None:
    """Occluding ellipses, rectangles and triangles with power-law sizes, drawn in place.

    Shapes with a radius below ``smallest_px`` are left out: a coarse texture cannot resolve them.

    Source: Lee, Mumford, Huang, "Occlusion models for natural images", IJCV 2001 (sizes ~ r^-3).
    """
    height, width = image.shape
    count = rng.poisson(per_m2 * height * width / scale**2)
    smallest, largest = size_m
    # Inverse transform of the density r^-3 between the two sizes.
    radii = scale * (smallest**-2 - rng.random(count) * (smallest**-2 - largest**-2)) ** -0.5
    centres = rng.random((count, 2)) * (width, height)
    tones = rng.integers(levels[0], levels[1] + 1, count)
    kinds, angles, flattening = rng.integers(0, 3, count), rng.random(count), rng.uniform(0.3, 1.0, count)
    drawn = radii >= smallest_px
    centres, tones, kinds = centres[drawn], tones[drawn], kinds[drawn]
    radii, angles, flattening = radii[drawn], angles[drawn], flattening[drawn]
    for radius, centre, tone, kind, turn, flat in zip(
        radii, centres, tones.tolist(), kinds.tolist(), angles, flattening, strict=True
    ):
        sides = _SIDES[kind]
        if sides:
            corners = np.array(
                [
                    (np.cos(2 * np.pi * (turn + k / sides)), np.sin(2 * np.pi * (turn + k / sides)))
                    for k in range(sides)
                ]
            )
            cv2.fillConvexPoly(image, np.rint(centre + radius * corners * (1, flat)).astype(np.int32), tone)
        else:
            axes = (max(1, round(radius)), max(1, round(radius * flat)))
            cv2.ellipse(
                image, (int(centre[0]), int(centre[1])), axes, _FULL_TURN_DEG * turn, 0, 360, tone, -1
            )


_SIDES = (0, 4, 3)


def blotches(image: np.ndarray, rng: np.random.Generator, size_px: float, levels: tuple[int, int]) -> None:
    """Fill the image with ragged patches of about ``size_px``, each of one tone between ``levels``."""
    height, width = image.shape
    tones = rng.integers(
        levels[0], levels[1] + 1, (int(height / size_px) + 4, int(width / size_px) + 4), dtype=np.uint8
    )
    columns, rows = (
        np.arange(side, dtype=np.float32) / np.float32(size_px) + 1.5 for side in (width, height)
    )
    shift = [0.6 * np.clip(fractal_noise((height, width), rng, 0.95), -2, 2) for _ in range(2)]
    image[:] = cv2.remap(
        tones,
        columns[None] + shift[0],
        rows[:, None] + shift[1],
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_WRAP,
    )


def courses(
    image: np.ndarray,
    scale: float,
    rng: np.random.Generator,
    unit_m: tuple[float, float],
    bond: float,
    spread: float,
) -> None:
    """Draw bricks, flags, tiles or boards in rows, each of its own tone, with dark joints.

    Args:
        image: (h, w) uint8, overwritten.
        scale: pixels per metre.
        rng: the random stream.
        unit_m: width and height of a unit, joint included.
        bond: shift of every other row, in units.
        spread: standard deviation of the tones, gray levels.
    """
    height, width = image.shape
    wide, high = max(4.0, unit_m[0] * scale), max(4.0, unit_m[1] * scale)
    joint = max(1, round(0.006 * scale))
    phase = rng.random() * wide
    image[:] = dark = int(rng.integers(60, 95))
    rows, columns = int(np.ceil(height / high)), int(np.ceil(width / wide)) + 2
    tones = np.clip(rng.normal(140, spread, (rows, columns)), 50, 235).astype(np.uint8)
    across = np.arange(width)
    for odd in (0, 1):
        left = np.rint(np.arange(columns) * wide - (phase + bond * wide * odd))
        unit = np.searchsorted(left, across, side="right") - 1
        in_joint = across > np.rint(left + wide)[unit] - joint
        for row in range(odd, rows, 2):
            line = tones[row, unit]
            line[in_joint] = dark
            image[round(row * high) : round((row + 1) * high) - joint + 1] = line


def text_block(image: np.ndarray, rng: np.random.Generator, glyph_px: float, ink: int) -> None:
    """Lines of word-like random glyphs over the whole image, in place."""
    height, width = image.shape
    rows, columns = int(height / (1.7 * glyph_px)), int(width / (0.8 * glyph_px))
    if rows < 1 or columns < 2:
        return
    cells = rng.random((rows, 7, columns, 4)) < 0.55
    cells[:, 5:], cells[..., 3] = False, False
    cells &= (rng.random((rows, columns)) > 0.18)[:, None, :, None]
    lengths = columns - rng.integers(0, max(1, columns // 2), rows)
    cells &= (np.arange(columns) < lengths[:, None])[:, None, :, None]
    bitmap = cells.reshape(rows * 7, columns * 4).astype(np.uint8)
    mask = cv2.resize(bitmap, (width, height), interpolation=cv2.INTER_NEAREST)
    image[mask > 0] = ink


def fit_levels(image: np.ndarray, mean_level: float, deviation: float) -> np.ndarray:
    """Shift and stretch the gray levels to a mean and a standard deviation.

    Levels are clipped to the range of a camera; the mean is kept despite that.

    Args:
        image: (h, w) uint8.
        mean_level: mean of the result, gray levels, met within 0.5.
        deviation: standard deviation before clipping, gray levels.

    Returns:
        (h, w) uint8; constant if the image is.
    """
    counts = np.bincount(image.reshape(-1), minlength=256)
    levels = np.arange(256.0)
    share = counts / counts.sum()
    centre = share @ levels
    spread = np.sqrt(share @ (levels - centre) ** 2)
    gain = deviation / spread if spread > 0 else 0.0
    stretched = gain * (levels - centre)
    offset = mean_level
    # Clipping moves the mean; shifting the levels against it converges within a few iterations.
    for _ in range(8):
        offset += mean_level - share @ np.clip(stretched + offset, BLACK_LEVEL, WHITE_LEVEL)
    table = np.clip(np.rint(stretched + offset), BLACK_LEVEL, WHITE_LEVEL)
    return cv2.LUT(image, table.astype(np.uint8))
