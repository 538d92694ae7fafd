"""How far the distributions of sequences lie apart, and the figures of the page."""

from collections.abc import Sequence as Many
from typing import Any

import numpy as np

from dslab.experiments.realism.footage import Footage
from dslab.experiments.realism.measures import MEASURES

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def distance(a: np.ndarray, b: np.ndarray) -> float | None:
    """Largest difference of the distribution functions of two samples, 0 to 1; None if one is empty.

    It has no unit and does not ask how the values are scaled (Kolmogorov and Smirnov). No test is made of it:
    observations of one map depend on one another.
    """
    if not len(a) or not len(b):
        return None
    a, b = np.sort(a), np.sort(b)
    at = np.concatenate([a, b])
    below = (np.searchsorted(x, at, "right") / len(x) for x in (a, b))
    return float(np.abs(next(below) - next(below)).max())


def footage_content(footage: Many[Footage]) -> dict[str, Any]:
    """All figures of a comparison, JSON-like; the first sequence is the one that others are compared with.

    Args:
        footage: at least one sequence.
    """
    first = footage[0]
    measures = [
        {
            "name": m.name,
            "label": m.label,
            "meaning": m.meaning,
            "group": m.group,
            "log": m.log,
            "edges": m.edges().tolist(),
            "sequences": [
                {
                    "name": f.name,
                    "values": len(f.values[m.name]),
                    "quantiles": _quantiles(f.values[m.name]),
                    "histogram": m.histogram(f.values[m.name]).tolist(),
                    "distance": distance(f.values[m.name], first.values[m.name]),
                }
                for f in footage
            ],
        }
        for m in MEASURES
    ]
    return {
        "reference": first.name,
        "quantiles": list(_QUANTILES),
        "sequences": [
            {"name": f.name, "figures": f.figures, "scale_along": list(f.scale_along)} for f in footage
        ],
        "measures": measures,
    }


def _quantiles(values: np.ndarray) -> list[float | None]:
    return np.quantile(values, _QUANTILES).tolist() if len(values) else [None] * len(_QUANTILES)
