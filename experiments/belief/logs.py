"""Logged hypotheses of batches: what was supposed, what every view said of it, and whether it was so."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.evaluation.hypotheses import HYPOTHESES_FILE
from dslab.experiments.result_folder import SUMMARY_FILE
from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import write_file
from dslab.slam.belief.model import Sight, Unseen

_HYPOTHESIS = ["kind", "map", "supposed_by", "place"]


@dataclass(frozen=True)
class Asked:
    """A hypothesis and the views that were asked for it, those that supposed it left out.

    Attributes:
        run: folder of the run, with that of its batch.
        kind: ``relocalization``, ``loop`` or ``join``.
        false: whether it is false, by the audit; that of most of its views.
        unseen: the motion to the place, as first supposed.
        sights: of every view, in order.
        torn: share of the map's observations that the correction of a loop tears; NaN if it was not asked, or
            if something false was declared before: in a wrong map right loops tear.
    """

    run: str
    kind: str
    false: bool
    unseen: Unseen
    sights: tuple[Sight, ...]
    torn: float = np.nan


def read_logs(places: Sequence[Path], numbers: range | None = None) -> list[Asked]:
    """Hypotheses in the runs of batches, or in collected files; what the audit could not judge is left out.

    Args:
        places: folders or files.
        numbers: of the runs to read; all by default.

    Raises:
        InputError: a folder has no logged run, a file is none or of an older release, or no hypothesis of
            these runs could be judged.
    """
    asked = [
        one
        for place in places
        for table, run in _tables(place)
        if numbers is None or int(run.rpartition("/")[2]) in numbers
        for one in _asked(table, run)
    ]
    if not asked:
        problem = "no hypothesis in its logs can be judged"
        remedy = "log runs with a truth and with losses" if numbers is None else "give other --runs"
        raise InputError(", ".join(map(str, places)), problem, remedy)
    return asked


def collect(places: Sequence[Path], file: Path, views: int, right_joins: int) -> tuple[int, int]:
    """Write the logs of batches as one file, thinned: of a hypothesis some views, evenly spaced.

    Angles and ratios are rounded, by less than the model can tell.

    Args:
        places: folders of batches.
        file: to write, Parquet.
        views: most views of a hypothesis.
        right_joins: most right joins of a run; there is one for every other keyframe.

    Returns:
        Numbers of hypotheses and of rows that it has.
    """
    kept, hypotheses = [], 0
    for place in places:
        for table, run in _tables(place):
            joins = 0
            for _, own in _judged(table).groupby(_HYPOTHESIS, sort=False):
                if own["kind"].iloc[0] == "join" and not bool(own["false"].to_numpy(bool).any()):
                    joins += 1
                    if joins > right_joins:
                        continue
                is_view = np.flatnonzero(_is_view(own))
                rows = is_view[np.unique(np.linspace(0, len(is_view) - 1, views).round().astype(int))]
                rows = np.union1d(rows, np.flatnonzero(~_is_view(own)))
                kept += [own.iloc[rows].assign(run=run)] if len(rows) else []
                hypotheses += len(rows) > 0
    if not kept:
        raise InputError(", ".join(map(str, places)), "no hypothesis in its logs can be judged", "log others")
    whole = pd.concat(kept, ignore_index=True)
    whole["shown"] = [_rounded(values) for values in whole["shown"]]
    for name in ("angle", "zoom"):
        whole[name] = [np.round(values, 2) for values in whole[name]]
    options = {"index": False, "compression": "zstd", "compression_level": 15}
    write_file(file, lambda place: whole.to_parquet(place, **options))
    return hypotheses, len(whole)


def _rounded(values: np.ndarray) -> np.ndarray:
    """Likelihood ratios to a twentieth of a decade: what is between does not pay its bytes."""
    decade = np.log10(np.maximum(values, 1e-3))
    return np.where(values < 1e-3, 0.0, 10 ** (np.round(20 * decade) / 20)).astype(np.float32)


def _tables(place: Path) -> Iterator[tuple[pd.DataFrame, str]]:
    """Tables of views and the runs that they are of."""
    if place.is_file():
        try:
            whole = pd.read_parquet(place)
            runs = whole.groupby("run", sort=False)
        except (OSError, ValueError, KeyError):
            remedy = "name a file of `dslab belief collect`"
            raise InputError(str(place), "it is no table of hypotheses", remedy) from None
        for run, table in runs:
            yield table, str(run)
        return
    files = sorted(place.glob(f"runs/*/*/*/{HYPOTHESES_FILE}"))
    if not files:
        remedy = "run its batch with hypotheses: true"
        raise InputError(str(place), f"no run in it has a {HYPOTHESES_FILE}", remedy)
    for file in files:
        table = pd.read_parquet(file)
        asked_of_wrong_map = ~_is_view(table) & (table["frame"].to_numpy() > _first_false(file.parent))
        yield table.iloc[np.flatnonzero(~asked_of_wrong_map)], str(file.parent.relative_to(place.parent))


def _first_false(run: Path) -> float:
    """Frame at which a run declared something false first; infinite if it did not."""
    try:
        audit = json.loads((run / SUMMARY_FILE).read_bytes())["audit"]
        declared = [one for kind in ("loops", "joins", "fusions", "relocalizations") for one in audit[kind]]
    except (OSError, ValueError, KeyError, TypeError):
        return np.inf
    return min((one["frame"] for one in declared if one["false"]), default=np.inf)


def _judged(table: pd.DataFrame) -> pd.DataFrame:
    """Views whose truth is known, but for those that supposed the place."""
    known = table["false"].notna().to_numpy() & ~table["proposes"].to_numpy(bool)
    return table.iloc[np.flatnonzero(known)]


def _asked(table: pd.DataFrame, run: str) -> list[Asked]:
    missing = [name for name in (*Sight._fields, *Unseen._fields) if name not in table]
    if missing:
        raise InputError(run, f"its log of hypotheses has no {missing[0]}", "log it again with this release")
    found = []
    for _, rows in _judged(table).groupby(_HYPOTHESIS, sort=False):
        is_view, torn = _is_view(rows), np.nan
        if not is_view.all():
            torn = float(rows["torn"][~is_view].iloc[-1])
        views = rows[is_view]
        sights = tuple(
            Sight(*(np.asarray(getattr(view, name)) for name in Sight._fields)) for view in views.itertuples()
        )
        false = bool(rows["false"].astype(float).mean() > 0.5)
        first = rows.iloc[0]
        unseen = Unseen(*(float(first[name]) for name in Unseen._fields))
        found.append(Asked(run, str(first["kind"]), false, unseen, sights, torn))
    return found


def _is_view(rows: pd.DataFrame) -> np.ndarray:
    """(n,) bool, whether a row is a view; a few say what a loop's correction tears."""
    return rows["torn"].isna().to_numpy() if "torn" in rows else np.ones(len(rows), np.bool_)
