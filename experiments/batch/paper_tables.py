"""A batch in the layout of the paper's tables, beside the paper's own figures.

Source: Huang et al., "Dual-SLAM: A framework for robust single camera navigation", IROS 2020, Tables I to
    III.
"""

from pathlib import Path

import pandas as pd

from dslab.experiments.batch.rows import ERROR
from dslab.experiments.eq1.units import RECOVERING
from dslab.experiments.report.paper_figures import TABLE_1, TABLE_1_FAILED
from dslab.experiments.statistics.paper import TABLE_II, TABLE_III
from dslab.sim.io.folders import subfolder, write_file

TABLES_DIR = "tables"
PUBLISHED = " (paper)"
"""End of the names of columns and rows with the paper's figures, which are of other data."""
NO_MAP, UNSTABLE = "⊗", "∩"
"""The paper's signs: no trial has a map; some trials have none that is intact."""
_PAPER_SYSTEMS = {
    "ORB-SLAM": "orb_slam_m",
    "Dual-SLAM": "dual_m",
    "Dual-SLAM⁺": "dual_plus_m",
    "LDSO": "ldso_m",
}
_TEX = str.maketrans(
    {NO_MAP: r"$\otimes$", UNSTABLE: r"$\cap$", "⁺": "$^+$"}
    | {sign: rf"\{sign}" for sign in "&#{}_%$"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)


def table_1(rows: pd.DataFrame) -> pd.DataFrame:
    """Median RMSE of the keyframes, metres, per sequence and system; in the last row failed trials.

    A trial fails if its map is not intact. Sequences of KITTI, real or made like them, have the paper's
    figures beside.
    """
    systems = list(dict.fromkeys(rows.system))
    table = []
    for source, own in rows.groupby("source", sort=False):
        line = {"sequence": short_name(str(source))}
        line |= {system: _rmse(own[own.system == system]) for system in systems}
        published = next((row for row in TABLE_1 if row.name.endswith(f" {_number(str(source))}")), None)
        for name, field in _PAPER_SYSTEMS.items():
            value = None if published is None else getattr(published, field)
            line[name + PUBLISHED] = "" if published is None else NO_MAP if value is None else f"{value:.2f}"
        table.append(line)
    failed = {system: str(_failures(rows[rows.system == system])) for system in systems}
    totals = {name + PUBLISHED: str(failed) for name, failed in TABLE_1_FAILED.items()}
    return pd.DataFrame([*table, {"sequence": "failed trials"} | failed | totals])


def table_2(rows: pd.DataFrame) -> pd.DataFrame:
    """Failed trials of all, per data set and system, and how much less often than the first each fails."""
    systems = list(dict.fromkeys(rows.system))
    sets = dict(list(rows.groupby(rows.source.map(_data_set), sort=False)))
    table = [
        {"data set": name} | {s: _rate(own[own.system == s]) for s in systems}
        for name, own in (sets | {"total": rows}).items()
    ]
    first = _failures(rows[rows.system == systems[0]])
    reduced = {s: _reduction(_failures(rows[rows.system == s]), first) for s in systems[1:]}
    table.append({"data set": "failure reduction", systems[0]: "n.a."} | reduced)
    published = [
        {"data set": name + PUBLISHED} | {s: f"{failed}/{of}" for s, (failed, of) in own.items()}
        for name, own in TABLE_II.items()
    ]
    return pd.concat([pd.DataFrame(table), pd.DataFrame(published)]).fillna("")


def table_3(rows: pd.DataFrame) -> pd.DataFrame:
    """Recoveries: trials that need one, how they end, by which thread, how long they take, per data set."""
    table = []
    needed = rows.recoveries_needed.fillna(0) > 0
    able = {*RECOVERING, *rows.system[needed]}
    rows = rows.loc[rows.system.isin(able)]
    for _, own in rows.groupby([rows.source.map(_data_set), "system"], sort=False):
        name, system = _data_set(own.source.iloc[0]), own.system.iloc[0]
        needs = own[needed[own.index]]
        recovered = needs.recovered_by_first + needs.recovered_by_later
        table.append(
            {
                "system": system,
                "data set": name,
                "trials": len(own),
                "needs recovery": len(needs),
                "failure": int((~needs.intact.fillna(False)).sum()),
                "recoveries": int(needs.recoveries_needed.sum()),
                "success": int(recovered.sum()),
                "with thread 1": int(needs.recovered_by_first.sum()),
                "with a later one": int(needs.recovered_by_later.sum()),
                "mean time, s": _text(needs.recovery_s.mean()),
            }
        )
    published = [
        {
            "system": counts.system + PUBLISHED,
            "data set": counts.dataset,
            "trials": counts.trials,
            "needs recovery": counts.breakages,
            "failure": counts.failures,
            "recoveries": counts.breakages,
            "success": counts.with_one + counts.with_two,
            "with thread 1": counts.with_one,
            "with a later one": counts.with_two,
            "mean time, s": "",
        }
        for counts in TABLE_III
    ]
    return pd.DataFrame([*table, *published])


def write_tables(rows: pd.DataFrame, folder: Path) -> dict[str, pd.DataFrame]:
    """Write the tables as CSV and LaTeX into a folder of the batch, and return them by name."""
    made = rows[rows.ended != ERROR]
    tables = (
        {"table_1": table_1(made), "table_2": table_2(made), "table_3": table_3(made)} if len(made) else {}
    )
    place = subfolder(folder, TABLES_DIR)
    for name, table in tables.items():
        write_file(place / f"{name}.csv", lambda path, table=table: table.to_csv(path, index=False))
        text = latex(table)
        write_file(place / f"{name}.tex", lambda path, text=text: path.write_text(text, encoding="utf-8"))
    return tables


def latex(table: pd.DataFrame) -> str:
    """A table as a LaTeX ``tabular``, to be put between the rules of one's own."""
    rows = [list(map(str, table.columns)), *table.astype(str).to_numpy().tolist()]
    lines = [" & ".join(word.translate(_TEX) for word in row) + r" \\" for row in rows]
    lines.insert(1, r"\hline")
    return "\n".join([rf"\begin{{tabular}}{{l{'r' * (len(rows[0]) - 1)}}}", *lines, r"\end{tabular}", ""])


def _rmse(trials: pd.DataFrame) -> str:
    known = trials.keyframe_ate_m.fillna(trials.ate_m).dropna()
    if not len(known):
        return NO_MAP
    median = known.median()
    return f"{median:.{2 if median >= 0.1 else 3}f}{' ' + UNSTABLE if _failures(trials) else ''}"


def _failures(trials: pd.DataFrame) -> int:
    return int((~trials.intact.fillna(False)).sum())


def _rate(trials: pd.DataFrame) -> str:
    return f"{_failures(trials)}/{len(trials)}"


def _reduction(failures: int, first: int) -> str:
    return f"1-{failures}/{first} = {1 - failures / first:.2f}" if first else "n.a."


def _text(value: float) -> str:
    return "" if pd.isna(value) else f"{value:.2f}"


def short_name(source: str) -> str:
    """A name of a sequence: its folder's, or the scenario's."""
    return Path(source).name if Path(source).exists() else source


def _data_set(source: str) -> str:
    """Data set of a sequence: the folder above it, or the scenario's family."""
    path = Path(source)
    return path.absolute().parent.name if path.exists() else source.partition("/")[0]


def _number(source: str) -> str:
    """Number of a drive of KITTI; empty for other sequences."""
    name = Path(source).name
    kitti = "kitti" in source.lower()
    return name if kitti and name.isdigit() and len(name) == 2 else ""
