import numpy as np
import pytest

from dslab.slam.features._spread_kernels import spread_corners

WIDTH, HEIGHT = 200, 150


def make_corners(kind, n=800, seed=0):
    rng = np.random.default_rng(seed)
    pixels = rng.choice(WIDTH * HEIGHT, n, replace=False)
    if kind == "clump":  # nine of ten in a corner of 40 x 40
        inside = rng.permutation(1600)[: n * 9 // 10]
        pixels[: len(inside)] = inside // 40 * WIDTH + inside % 40
        pixels = rng.permutation(np.unique(pixels))
    contrasts = rng.integers(8, 60, len(pixels)).astype(np.uint8)
    return (pixels % WIDTH).astype(np.int32), (pixels // WIDTH).astype(np.int32), contrasts


def slow_spread(xs, ys, contrasts, n_wanted):
    """By the definition: the coarsest grid in which a corner is the strongest of its cell, then contrast."""
    size = max(WIDTH, HEIGHT)
    grids = [2**k for k in range(20) if size >= 4 * 2**k]
    coarsest = np.full(len(xs), len(grids))
    order = np.lexsort([np.arange(len(xs)), -contrasts.astype(int)])
    for depth, columns in reversed(list(enumerate(grids))):
        cell = ys.astype(int) * columns // size * columns + xs.astype(int) * columns // size
        _, first = np.unique(cell[order], return_index=True)
        coarsest[order[first]] = depth
    return set(np.lexsort([np.arange(len(xs)), -contrasts.astype(int), coarsest])[:n_wanted].tolist())


@pytest.mark.parametrize("kind", ["even", "clump"])
@pytest.mark.parametrize("n_wanted", [1, 2, 3, 50, 301, 790])
def test_the_choice_is_as_defined(kind, n_wanted):
    xs, ys, contrasts = make_corners(kind)
    contrasts = np.random.default_rng(1).permutation(len(xs)).astype(np.uint8)  # few are equal
    chosen = spread_corners(xs, ys, contrasts, HEIGHT, WIDTH, n_wanted)
    assert chosen.dtype == np.int32
    assert len(chosen) == min(n_wanted, len(xs))
    expected = slow_spread(xs, ys, contrasts, n_wanted)
    # Of equals at the end any may be chosen.
    assert len(expected ^ set(chosen.tolist())) <= 2 * (np.bincount(contrasts).max() - 1)


def test_of_more_corners_fewer_are_chosen_again():
    xs, ys, contrasts = make_corners("even")
    few, many = (set(spread_corners(xs, ys, contrasts, HEIGHT, WIDTH, n).tolist()) for n in (100, 300))
    assert few < many


def test_a_cluster_does_not_displace_other_corners():
    xs, ys, contrasts = make_corners("clump")
    contrasts[(xs < 40) & (ys < 40)] = 255  # by contrast alone the clump would win every place
    chosen = spread_corners(xs, ys, contrasts, HEIGHT, WIDTH, 100)
    cells = {(x // 40, y // 40) for x, y in zip(xs.tolist(), ys.tolist(), strict=True)}
    assert {(x // 40, y // 40) for x, y in zip(xs[chosen], ys[chosen], strict=True)} == cells
    assert ((xs[chosen] < 40) & (ys[chosen] < 40)).mean() < 0.7


def test_few_corners_are_all_kept():
    xs, ys, contrasts = make_corners("even", n=30)
    assert spread_corners(xs, ys, contrasts, HEIGHT, WIDTH, 30).tolist() == list(range(30))
    assert len(spread_corners(xs[:0], ys[:0], contrasts[:0], HEIGHT, WIDTH, 30)) == 0


def test_none_requested_gives_none():
    assert len(spread_corners(*make_corners("even"), HEIGHT, WIDTH, 0)) == 0
