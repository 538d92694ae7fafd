"""``dslab batch``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dslab.experiments.cli.console import (
    JsonOption,
    SystemsOption,
    WorkersOption,
    number,
    out,
    print_json_line,
    print_rows,
    progress_bars,
    say,
    share,
)

if TYPE_CHECKING:
    import pandas as pd

    from dslab.experiments.batch.doses import DoseSeries

_WORDS = (
    "Intact map: from the first pose to the end one map has no gap of more than 5 s; a run that is lost for "
    "less than that at its end has one. False / decl.: loops, relocalizations and fusions that are false, of "
    "those declared. Complete: frames with a final pose in the largest map; ATE is over these."
)


def batch_command(
    batch: Annotated[Path, typer.Argument(metavar="SPEC.yaml", help="The batch.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder of the results; resumed if it exists.")],
    workers: WorkersOption = 1,
    systems_dir: SystemsOption = None,
    figures: Annotated[
        bool, typer.Option("--figures", help="Draw Figures 6 to 9 of the paper too, of these runs.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run systems over many sequences, several times each, and print a table.

    SPEC.yaml names sequences (folders, bags, patterns, scenarios), systems and the number of runs. Killed and
    started again, a batch goes on where it was. Systems that take frames in real time run alone, after the
    others. Writes runs.parquet and runs.csv, a row per run, pairs.csv, in which every further system
    stands beside the first one over the frames that both have placed, breakages.csv, a row per breakage,
    tables in the layout of the paper's, its figures on request, and the result folder of each run. A stress
    with a list of doses, as exposure_s=[0.02,0.05,0.1], is run at each; then dose_response.csv and a plot
    have every system against the dose, and there are no tables as in the paper. For example:

    `dslab batch kitti.yaml --workers 2 --out out/kitti`
    """
    from dslab.experiments.batch.breakages import BREAKAGES_FILE, breakages, rescues
    from dslab.experiments.batch.dose_figures import DOSE_FILE, DOSE_PLOT, write_dose_response
    from dslab.experiments.batch.paper_figures import FIGURES_DIR, write_figures
    from dslab.experiments.batch.paper_tables import TABLES_DIR, write_tables
    from dslab.experiments.batch.run import CSV_FILE, run_batch
    from dslab.experiments.batch.spec import read_batch
    from dslab.experiments.batch.table import PAIRS_FILE, pairs, sums
    from dslab.experiments.comparison.dose_response import dose_table
    from dslab.scenarios.errors import notice
    from dslab.sim.io.folders import write_file

    spec, sources = read_batch(batch)
    with progress_bars() as show:
        rows = run_batch(spec, sources, out_dir, workers, systems_dir or (), show)
    found, beside, broken = sums(rows), pairs(rows, out_dir), breakages(rows, out_dir)
    rescued = rescues(broken)
    for name, table in ((PAIRS_FILE, beside), (BREAKAGES_FILE, broken)):
        write_file(out_dir / name, lambda path, table=table: table.to_csv(path, index=False))
    points, drawn = write_dose_response(rows, spec.series, out_dir) if spec.series else [], []
    if not points:  # the paper has no doses
        write_tables(rows, out_dir)
        drawn = write_figures(rows, out_dir) if figures else []
    elif figures:
        notice("--figures", "the paper has no doses: its figures are of batches without a list of them")
    if as_json:
        tables = {"rows": found, "pairs": beside, "rescues": rescued}
        tables |= {"dose_response": dose_table(points)} if points else {}
        print_json_line({name: _records(table) for name, table in tables.items()})
    else:
        _print_tables(spec.series, found, points, beside, rescued)
        say(f"every run  {out_dir / CSV_FILE}, {PAIRS_FILE}, {BREAKAGES_FILE}")
        places = [out_dir / TABLES_DIR, *([out_dir / FIGURES_DIR] if drawn else [])]
        if points:
            say(f"against the dose  {out_dir / FIGURES_DIR / DOSE_PLOT}.png, {DOSE_FILE}")
        else:
            say(f"as in the paper  {', '.join(map(str, places))}")
    _check_made(rows)


def _print_tables(
    series: "DoseSeries | None",
    found: "pd.DataFrame",
    points: list[dict[str, Any]],
    beside: "pd.DataFrame",
    rescued: "pd.DataFrame",
) -> None:
    """Print the sums of a batch, its points against the dose, its pairs and its rescues."""
    from dslab.experiments.batch.paper_tables import short_name
    from dslab.experiments.cli.run_tables import INTERVALS, dose_row
    from dslab.experiments.comparison.dose_response import dose_title

    out.print("medians over the runs, and sums of breakages and declarations")
    for _, own in found.groupby(["source", "dose"], sort=False, dropna=False):
        print_rows(_sum_rows(own, found), short_name(own.source.iloc[0]) + _at(own, series))
    out.print(_WORDS)
    if points and series:
        print_rows(map(dose_row, points), f"against the dose, {INTERVALS}: {dose_title(*series.about)}")
    if len(beside):
        print_rows(_beside(beside), f"over {found.system.iloc[0]}, the same frames")
    for _, own in rescued.groupby(["source", "dose"], dropna=False) if len(rescued) else ():
        where = Path(own.source.iloc[0]).name + _at(own, series)
        title = f"{where}: healthy maps that broke, and the threads that found back"
        print_rows(map(_rescue_row, _records(own)), title)


def _at(own: "pd.DataFrame", series: "DoseSeries | None") -> str:
    """The dose of some rows; empty without a series."""
    return f", {series.label(float(own.dose.iloc[0]))}" if series else ""


def _check_made(rows: "pd.DataFrame") -> None:
    """Raise MachineError, after all is printed, if runs could not be made."""
    from dslab.experiments.batch.rows import ERROR
    from dslab.scenarios.errors import MachineError

    lacking = rows[rows.ended == ERROR]
    if len(lacking):
        first = lacking.iloc[0]
        problem = f"{len(lacking)} of {len(rows)} runs could not be made: {first.ended_message}"
        remedy = "mend it and run the same command again"
        raise MachineError(f"{first.source}, {first.system}, run {first.run}", problem, remedy)


def _records(table: "pd.DataFrame") -> list[dict]:
    return table.astype(object).where(table.notna(), None).to_dict("records")


def _sum_rows(own: "pd.DataFrame", every: "pd.DataFrame") -> list[dict[str, Any]]:
    """The rows of one table; a column of faults only where a row of any table has some."""
    rows, shown = (list(map(_sum_row, _records(table))) for table in (own, every))
    unused = {name for name in _FAULTS if all(row[name] is None for row in shown)}
    return [{name: value for name, value in row.items() if name not in unused} for row in rows]


_FAULTS = ("ended\nbadly", "false /\ndecl.")


def _sum_row(row: dict[str, Any]) -> dict[str, Any]:
    return {
        "": row["system"],
        "intact\nmap": f"{row['intact']} of {row['runs']}",
        _FAULTS[0]: row["ended_badly"] or None,
        "break-\nages": number(row["breakages"], 0),
        _FAULTS[1]: f"{row['false']} / {row['declared']}" if row["declared"] else None,
        "ATE m,\nkeyfr.": number(row["keyframe_ate_m"]),
        "ATE m,\nframes": number(row["ate_m"]),
        "RPE m\nper s": number(row["rpe_m"]),
        "com-\nplete": share(row["completeness"]),
        "CPU ms/\nframe": number(row["cpu_ms_median"], 1),
    }


def _rescue_row(row: dict[str, Any]) -> dict[str, Any]:
    """Breakages of a system, by cause and by whether views on either side are shared."""
    threads = {name.replace("_", "\n"): of for name, of in row.items() if name.startswith("thread_")}
    return {
        "": row["system"],
        "during": row["cause"].replace("_", " ") or "no stress",
        "views": row["views"],
        "broke": row["breakages"],
        "res-\ncued": row["recovered"],
        **threads,
        "false": row["false_fusion"],
        "fused\nin s": number(row["to_fusion_s_median"]),
        "95 %": number(row["to_fusion_s_p95"]),
    }


def _beside(beside: "pd.DataFrame") -> Iterator[dict[str, Any]]:
    """Every system over the first one: quantiles over all runs, the mean over the sequences."""
    from dslab.experiments.batch.table import beside_first

    for system, own in beside_first(beside).groupby("system", sort=False):
        for row in own.to_dict("records"):
            of_runs = ("median", "mean", "low", "high", "min", "max")
            figures = {of: number(row[of] if row["runs"] else None) for of in of_runs}
            figures["95 % of the mean"] = f"{figures.pop('low')} to {figures.pop('high')}"
            yield {"": f"{system}, {row['figure']}", "runs": row["runs"], **figures}
        yield {}
