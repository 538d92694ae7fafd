"""Logged hypotheses of batches: what was supposed, what every view said of it, and whether it was so."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.evaluation.hypotheses import HYPOTHESES_FILE
from dslab.scenarios.errors import InputError
from dslab.slam.belief.model import Sight, Unseen


@dataclass(frozen=True)
class Asked:
    """A hypothesis and the views that were asked for it, those that supposed it left out.

    Attributes:
        run: folder of the run.
        kind: ``relocalization``, ``loop`` or ``join``.
        false: whether it is false, by the audit; that of most of its views.
        unseen: the motion to the place, as first supposed.
        sights: of every view, in order.
        faults: what the rules that decide say against each, empty for nothing.
    """

    run: str
    kind: str
    false: bool
    unseen: Unseen
    sights: tuple[Sight, ...]
    faults: tuple[str, ...]


def read_logs(folders: Sequence[Path]) -> list[Asked]:
    """Hypotheses in the runs of batches; those that the audit could not judge are left out.

    Raises:
        InputError: a folder has no logged run, or no hypothesis could be judged.
    """
    asked: list[Asked] = []
    for folder in folders:
        files = sorted(folder.glob(f"runs/*/*/*/{HYPOTHESES_FILE}"))
        if not files:
            remedy = "run its batch with hypotheses: true"
            raise InputError(str(folder), f"no run in it has a {HYPOTHESES_FILE}", remedy)
        for file in files:
            asked += _asked(pd.read_parquet(file), str(file.parent))
    if not asked:
        problem, remedy = "no hypothesis in its logs can be judged", "log runs with a truth and with losses"
        raise InputError(", ".join(map(str, folders)), problem, remedy)
    return asked


def _asked(table: pd.DataFrame, run: str) -> list[Asked]:
    judged = table[table["false"].notna() & ~table["proposes"].astype(bool)]
    found = []
    for _, views in judged.groupby(["kind", "map", "supposed_by", "place"], sort=False):
        sights = tuple(
            Sight(*(np.asarray(getattr(view, name)) for name in Sight._fields)) for view in views.itertuples()
        )
        false = bool(views["false"].astype(float).mean() > 0.5)
        first = views.iloc[0]
        unseen = Unseen(*(float(first[name]) for name in Unseen._fields))
        found.append(Asked(run, str(first["kind"]), false, unseen, sights, tuple(views["fault"])))
    return found
