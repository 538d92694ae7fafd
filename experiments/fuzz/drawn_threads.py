"""Recovery threads of a random run: any kinds in any order, drawn by seed."""

from dslab.experiments.runs.execution import SystemKind
from dslab.slam.core.seeds import rng_for
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import ThreadSpec, parse_threads
from dslab.slam.factory import PAPERS

KINDS = ("orb", "sift", "direct", "gms")
"""Kinds that are drawn; those of the paper are the first two with other settings."""

_DRAWN = ("dual", "dual+")  # systems whose threads are drawn
_USUAL = "orb,sift"
_USUAL_SHARE = 0.3
_MOST = 3


def drawn_threads(seed: int) -> tuple[ThreadSpec, ...]:
    """Draw the recovery threads of a seed: often those of Algorithm 1, else one to three in any order."""
    rng = rng_for(seed, "random", "recovery threads")
    if rng.random() < _USUAL_SHARE:
        return parse_threads(_USUAL)
    count = int(rng.integers(1, _MOST + 1))
    return parse_threads(",".join(rng.permutation(KINDS)[:count]))


def drawn_settings(seed: int, kind: SystemKind) -> DualConfig | None:
    """Settings with the threads of a seed; None for the papers' systems, which have their own."""
    return None if kind in PAPERS else DualConfig(recovery_threads=drawn_threads(seed))


def drawn_kinds(seed: int, kind: SystemKind) -> str:
    """Kinds of the drawn threads in order; empty for a system without drawn ones."""
    return ",".join(spec.kind for spec in drawn_threads(seed)) if kind in _DRAWN else ""
