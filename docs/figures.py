"""Tables of measured figures, made from the published records in this folder."""

import json
import textwrap
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

from dslab.experiments.campaign.folder import read_experiment
from dslab.experiments.eq1.doses import AXES
from dslab.experiments.report.describe import interval_of_share, percent
from dslab.scenarios.describe import describe_kind, label_and_unit

HERE = Path(__file__).parent
THREADS = ("breaks", "ORB", "SIFT", "direct", "the paper's ORB")
PEERS = ("orbslam", "orbslam3")
VERDICTS = {"optimistic": "**optimistic**"}


def table(header: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    """A Markdown table; columns in which nothing stands are left out."""
    cells = [tuple(" ".join(str(cell).split()).replace("|", "\\|") for cell in row) for row in rows]
    kept = [k for k in range(len(header)) if any(row[k] for row in cells)]
    lines = [[header[k] for k in kept], ["---"] * len(kept), *([row[k] for k in kept] for row in cells)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def bullets(lines: Iterable[str]) -> list[str]:
    """Items of a Markdown list, in short lines."""
    return [textwrap.fill(line, 116, initial_indent="- ", subsequent_indent="  ") for line in lines]


def eq1_rescuable() -> str:
    """Failures with two threads over the trials that images could rescue."""
    rows = []
    for cell in _analysis()["over_rescuable"]:
        reading = cell["readings"]
        if cell["n"] == 2 and reading and reading["of_averages"]["ratio"] and cell["failures"] > 10:
            averages, measured = reading["of_averages"], interval_of_share(reading["measured"])
            predicted, ratio = percent(averages["predicted"]), with_ends(averages["ratio"])
            rows.append((_condition(cell["cell"]), reading["units"], predicted, measured, ratio))
    return table(("two threads, rescuable trials", "trials", "Eq. 1", "failed, D", "D / Eq. 1"), rows)


def eq1_one_thread() -> str:
    """Conditions of `eq1` with the thread ORB."""
    return _conditions(1, ("condition", "breaks, p₀", "ORB fails"))


def eq1_two_threads() -> str:
    """Conditions of `eq1` with the threads ORB and SIFT."""
    return _conditions(2, ("condition", "", "SIFT fails"))


def _conditions(n: int, header: tuple[str, ...]) -> str:
    failed = {(t["cell"], t["thread"]): percent(t["failed"]["value"]) for t in _analysis()["thread_shares"]}
    rows = []
    for cell in _cells(n):
        decided = cell["verdict_forecast"] not in ("saturated", "untested")
        verdicts = dict.fromkeys(
            VERDICTS.get(v, v) for v in (cell["verdict_in_units"], cell["verdict_forecast"])
        )
        dual, way = cell["shares"]["dual_failure"], cell["way_forecast"]
        rows.append(
            (
                _condition(cell["cell"]),
                percent(cell["shares"]["breakage"]["value"]) if n == 1 else "",
                failed[cell["cell"], n],
                percent(cell["eq1"]),
                percent(cell["weakest"]),
                interval_of_share(dual),
                f"{dual['value'] / cell['eq1']:.3g}" if cell["verdict_forecast"] != "untested" else "",
                with_ends(way) if decided else "",
                ", ".join(verdicts),
            )
        )
    figures = ("Eq. 1", "weakest link", "failed, D", "D / Eq. 1", "k", "independence, forecast")
    return table((*header, *figures), rows)


def eq1_pairs() -> str:
    """Odds ratios of two events, in the same run and across the runs of a sequence."""
    shown = [(0, 1), (0, 2), (0, 4), (1, 2), (1, 4), (3, 4)]
    pairs = [pair for pair in _analysis()["event_pairs"] if (pair["first"], pair["second"]) in shown]
    rows = [
        (
            " and ".join(THREADS[pair[of]] if pair[of] else "a breakage" for of in ("first", "second")),
            with_ends(pair["within"]),
            with_ends(pair["across"]),
            pair["telling"],
        )
        for pair in pairs
    ]
    return table(("both happen", "in the same run", "across runs of a sequence", "telling sequences"), rows)


def eq1_threads() -> str:
    """What threads cross in the crossing arm of `eq1`, and what the direct one adds to ORB and SIFT."""
    of_cells = {}
    for thread in _analysis()["thread_shares"]:
        of_cells.setdefault(thread["cell"], {})[thread["thread"]] = thread
    rows = []
    for cell, threads in of_cells.items():
        adds, needed = threads[3]["adds"], threads[3]["needed"]
        shares = (percent(threads[k]["failed"]["value"]) for k in (1, 2, 3))
        rows.append((_condition(cell), *shares, needed, interval_of_share(adds) if needed > 10 else ""))
    header = ("stress", "ORB fails", "SIFT", "direct", "ORB and SIFT fail", "of these direct crosses")
    return table(header, rows)


def eq1_false() -> str:
    """Alignments that threads declared in `eq1`, and how many were false."""
    threads = _report()["taxonomy"]["threads"]
    false = {(row["arm"], row["thread"]): row["false"] for row in threads}
    rows = [
        (THREADS[k], *(_of(false[arm, k]["events"], false[arm, k]["units"]) for arm in ("crossing", "free")))
        for k in (1, 2, 3, 4)
    ]
    return table(("thread", "false, crossing arm", "false, free arm"), rows)


def direct_thread() -> str:
    """What the direct thread crosses where ORB and SIFT both fail, in cells named before the run."""
    _, records = read_experiment(HERE / "direct-thread")
    rows = []
    for name, cell in records.groupby("cell"):
        both = cell[cell["cross_r1_failed"] & cell["cross_r2_failed"]]
        shares = (percent(cell[f"cross_r{k}_failed"].mean()) for k in (1, 2, 3))
        crossed, declared = (~both["cross_r3_failed"]).sum(), cell["cross_r3_declared"].sum()
        false = cell["cross_r3_false"].fillna(False).sum()
        rows.append(
            (_condition(str(name)), len(cell), *shares, _of(crossed, len(both)), _of(false, declared))
        )
    header = ("stress", "worlds", "ORB fails", "SIFT", "direct", "crosses, both others failed", "false")
    return table(header, rows)


def threads() -> str:
    """Three recovery threads in fourteen conditions of corridors."""
    spec, records = read_experiment(HERE / "threads")
    records = records[records["exposed"]]
    rows = []
    for name in spec.cell_names():
        cell = records[records["cell"] == name]
        failed = [cell[f"cross_r{k}_failed"].astype(bool) for k in (1, 2, 3)]
        both = failed[0] & failed[1]
        shares = (f"{100 * one.mean():.0f}" for one in failed)
        crossed = _of((both & ~failed[2]).sum(), both.sum())
        rows.append((_dosed(cell), len(cell), *shares, cell["rescuable"].sum(), crossed))
    header = (
        "stress, dose",
        "trials",
        "ORB fails, %",
        "SIFT",
        "direct",
        "rescuable",
        "crosses, both others failed",
    )
    return table(header, rows)


def ldso_stress() -> str:
    """Base, Dual-SLAM and direct odometry under the same stress."""
    rows = []
    for folder, kinds in (
        ("ldso", ("low_texture", "motion_blur", "fast_rotation", "low_light", "flicker")),
        ("ldso-flicker", ("flicker",)),
    ):
        _, records = read_experiment(HERE / folder)
        done = records[(records["outcome"] == "completed") & records["exposed"].fillna(False)]
        for kind in kinds:
            of_kind = done[done["kind"] == kind]
            dual, ldso = (of_kind[of_kind["system"] == name] for name in ("dual", "ldso"))
            happened = [system["breakage"] for system in (dual, ldso)]
            happened += [system["mission_cause"].notna() for system in (dual, ldso)]
            shares = (f"{100 * one.mean():.0f}" for one in happened)
            rows.append((_dosed(dual), len(dual), *shares))
    header = (
        "stress, dose",
        "corridors",
        "base breaks, %",
        "`ldso` breaks",
        "Dual-SLAM's mission fails",
        "`ldso`'s",
    )
    return table(header, rows)


@cache
def _report() -> dict[str, Any]:
    return json.loads((HERE / "eq1" / "report.json").read_text())


def _analysis() -> dict[str, Any]:
    return _report()["analysis"]


def _cells(n: int) -> list[dict[str, Any]]:
    return [cell for cell in _analysis()["cells"] if cell["n"] == n]


def _condition(cell: str) -> str:
    """``corridor/fog-creeping/1`` in words."""
    return f"{_stress(cell)}, {cell.partition('/')[0]}"


def _stress(cell: str) -> str:
    kind = next(part for part in cell.split("/")[-2:] if not part.isdigit())
    name, _, creeping = kind.partition("-")
    return f"{creeping} {describe_kind(name)}".strip()


def _dosed(cell: pd.DataFrame) -> str:
    """The stress and the dose of a cell's records."""
    kind, dose = cell[["kind", "severity"]].iloc[0]
    label, unit = label_and_unit(AXES[kind].field)
    return f"{describe_kind(kind)}, {label} {dose:g}{unit}"


def _of(events: object, units: object) -> str:
    return f"{events} of {units}"


def with_ends(of: dict[str, float | None]) -> str:
    """A figure with its interval in brackets, to two digits behind the point or three in all."""
    value, low, high = ("unbounded" if end is None else f"{round(end, 2) + 0.0:.3g}" for end in of.values())
    return f"{value} [{low}, {high}]"


def profiles() -> str:
    """`orbslam` beside C++ ORB-SLAM3: median of the runs of each sequence, and over sequences."""

    def median(of: pd.DataFrame) -> str:
        return f"{(of['ate_m']['orbslam'] / of['ate_m']['orbslam3']).median():.2f}"

    runs = pd.read_parquet(HERE / "profiles" / "runs.parquet")
    medians = runs.groupby(["stressed", "sequence", "system"])[["ate_m", "completeness", "share_tracked"]]
    wide = medians.median().astype(float).unstack("system")
    rows = []
    for (stressed, sequence), of in wide.iterrows():
        ate, held, tracked = (of[name] for name in ("ate_m", "completeness", "share_tracked"))
        rows.append(
            (
                f"{sequence}, stressed" if stressed else sequence,
                *(f"{ate[name]:.3g}" if ate[name] == ate[name] else "" for name in PEERS),
                f"{ate['orbslam'] / ate['orbslam3']:.2f}" if ate.notna().all() else "",
                *(percent(held[name]) for name in PEERS),
                *(percent(tracked[name]) for name in PEERS),
            )
        )
    apart = (wide["completeness"]["orbslam"] - wide["completeness"]["orbslam3"]).abs()
    told = (
        f"The ATE is {median(wide)} times ORB-SLAM3's in the median over sequences, "
        f"{median(wide.xs(False))} without the added stress and {median(wide.xs(True))} with it.\n"
        f"In {int((apart <= 0.15).sum())} of {len(wide)} sequences as many frames are in the largest map, "
        "to 15 points."
    )
    names = "ATE, m", "in the largest map", "tracked"
    ate, held, tracked = ((f"{name}: orbslam", "ORB-SLAM3") for name in names)
    header = ("sequence", *ate, "ratio", *held, *tracked)
    return f"{told}\n\n{table(header, rows)}"
