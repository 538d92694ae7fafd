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
    """Quadtree of Python lists."""
    leaves = [(list(range(len(xs))), (0, 0, WIDTH, HEIGHT))]
    progress = True
    while progress and len(leaves) < n_wanted:
        progress = False
        for k in sorted(range(len(leaves)), key=lambda k: -len(leaves[k][0])):
            members, (x0, y0, x1, y1) = leaves[k]
            if len(members) < 2:
                break
            mx, my = (x0 + x1 + 1) // 2, (y0 + y1 + 1) // 2
            boxes = [(x0, y0, mx, my), (mx, y0, x1, my), (x0, my, mx, y1), (mx, my, x1, y1)]
            children = [
                ([i for i in members if a <= xs[i] < c and b <= ys[i] < d], (a, b, c, d))
                for a, b, c, d in boxes
            ]
            children = [child for child in children if child[0]]
            if len(leaves) + len(children) - 1 <= n_wanted:
                leaves[k] = children[0]
                leaves += children[1:]
                progress = True
    return [max(members, key=lambda i: (contrasts[i], -i)) for members, _ in leaves]


@pytest.mark.parametrize("kind", ["even", "clump"])
@pytest.mark.parametrize("n_wanted", [1, 2, 3, 50, 301, 790])
def test_the_choice_agrees_with_python(kind, n_wanted):
    xs, ys, contrasts = make_corners(kind)
    chosen = spread_corners(xs, ys, contrasts, HEIGHT, WIDTH, n_wanted)
    assert chosen.dtype == np.int32
    assert chosen.tolist() == slow_spread(xs, ys, contrasts, n_wanted)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n_wanted", [5, 60, 333])
def test_the_choice_is_unique_and_nearly_complete(seed, n_wanted):
    chosen = spread_corners(*make_corners("clump", seed=seed), HEIGHT, WIDTH, n_wanted)
    assert n_wanted - 2 <= len(chosen) <= n_wanted
    assert len(np.unique(chosen)) == len(chosen)


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
