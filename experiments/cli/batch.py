"""``dslab batch``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from dslab.experiments.cli.console import (
    JsonOption,
    SystemsOption,
    number,
    out,
    print_json_line,
    print_table,
    progress_bars,
    share,
)

if TYPE_CHECKING:
    import pandas as pd


def batch_command(
    batch: Annotated[Path, typer.Argument(metavar="SPEC.yaml", help="The batch.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder of the results; resumed if it exists.")],
    workers: Annotated[int, typer.Option(min=1, help="Number of runs at a time.")] = 1,
    systems_dir: SystemsOption = None,
    figures: Annotated[
        bool, typer.Option("--figures", help="Draw Figures 6 to 9 of the paper too, of these runs.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run systems over many sequences, several times each, and print a table.

    SPEC.yaml names sequences (folders, patterns, scenarios), systems and the number of runs. Killed and
    started again, a batch goes on where it was. Systems that take frames in real time run alone, after the
    others. Writes runs.parquet and runs.csv, a row per run, pairs.csv, in which every further system
    stands beside the first one over the frames that both have placed, breakages.csv, a row per breakage,
    tables in the layout of the paper's, its figures on request, and the result folder of each run. For
    example:

    `dslab batch kitti.yaml --workers 2 --out out/kitti`

    `dslab batch kitti.yaml --out out/kitti --figures`
    """
    from dslab.experiments.batch.breakages import BREAKAGES_FILE, breakages, rescues
    from dslab.experiments.batch.paper_figures import FIGURES_DIR, write_figures
    from dslab.experiments.batch.paper_tables import TABLES_DIR, write_tables
    from dslab.experiments.batch.run import CSV_FILE, run_batch
    from dslab.experiments.batch.spec import read_batch
    from dslab.experiments.batch.table import PAIRS_FILE, pairs, sums
    from dslab.experiments.runs.files import plain
    from dslab.sim.io.folders import write_file

    spec, sources = read_batch(batch)
    with progress_bars() as show:
        rows = run_batch(spec, sources, out_dir, workers, systems_dir or (), show)
    found, beside = sums(rows), pairs(rows, out_dir)
    write_file(out_dir / PAIRS_FILE, lambda path: beside.to_csv(path, index=False))
    broken = breakages(rows, out_dir)
    rescued = rescues(broken)
    write_file(out_dir / BREAKAGES_FILE, lambda path: broken.to_csv(path, index=False))
    write_tables(rows, out_dir)
    drawn = write_figures(rows, out_dir) if figures else []
    if as_json:
        tables = {"rows": found, "pairs": beside, "rescues": rescued}
        print_json_line({name: plain(_records(table)) for name, table in tables.items()})
    else:
        out.print("medians over the runs")
        for table in _tables(found):
            out.print()
            print_table(table)
        if len(beside):
            print_table(_beside(beside, rows.system.iloc[0]))
        for table in _rescues(rescued) if len(rescued) else ():
            print_table(table)
        out.print(f"every run  {out_dir / CSV_FILE}, {PAIRS_FILE}, {BREAKAGES_FILE}", soft_wrap=True)
        places = [out_dir / TABLES_DIR, *([out_dir / FIGURES_DIR] if drawn else [])]
        out.print(f"as in the paper  {', '.join(map(str, places))}", soft_wrap=True)
    _check_made(rows)


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


def _beside(beside: "pd.DataFrame", first: str) -> Table:
    """Every system over the first one: quantiles over the runs of all sequences."""
    table = Table(title=f"over {first}, the same frames")
    for name in ("", "runs", "median", "mean", "least", "largest"):
        table.add_column(name, justify="right" if name else "left")
    for system, own in beside.groupby("system", sort=False):
        ratios = {
            "frames in the main map": own.posed / own.first_posed,
            "ATE on common frames": own.ate_m / own.first_ate_m,
            "CPU of tracking": own.cpu_ms / own.first_cpu_ms,
        }
        table.add_section()
        table.add_row(Text(str(system), "bold"))
        for name, ratio in ratios.items():
            known = ratio.replace([float("inf")], float("nan")).dropna()
            figures = (known.median(), known.mean(), known.min(), known.max()) if len(known) else [None] * 4
            table.add_row(name, str(len(known)), *(number(figure, 3) for figure in figures))
    return table


def _rescues(rescued: "pd.DataFrame") -> Iterator[Table]:
    """A table per source, with a row per system, cause and whether views on either side are shared."""
    threads = [str(name) for name in rescued if str(name).startswith("thread_")]
    counts = ["breakages", "recovered", *threads, "false_fusion"]
    titles = ("broke", "res-\ncued", *(name.replace("_", "\n") for name in threads), "false")
    for source, own in rescued.groupby("source"):
        title = f"{Path(str(source)).name}: healthy maps that broke, and the threads that found back"
        table = Table(title=Text(title), padding=(0, 1, 0, 0))
        for column in ("", "during", "views"):
            table.add_column(column)
        for column in (*titles, "fused\nin s", "95 %"):
            table.add_column(column, justify="right")
        for _, row in own.iterrows():
            cause = row.cause.replace("_", " ") or "no stress"
            times_s = map(number, (row.to_fusion_s_median, row.to_fusion_s_p95))
            table.add_row(row.system, cause, row.views, *map(str, row[counts]), *times_s)
        yield table


def _tables(found: "pd.DataFrame") -> Iterator[Table]:
    """A table per sequence, with the same columns."""
    from dslab.experiments.batch.paper_tables import short_name

    columns = (
        "intact\nmap", "ended\nbadly", "break-\nages", "false /\ndecl.", "ATE m,\nkeyfr.", "ATE m,\nframes",
        "RPE m\nper s", "com-\nplete", "CPU ms/\nframe",
    )  # fmt: skip
    known = found.astype(object).where(found.notna(), None)
    for source, own in known.groupby("source", sort=False):
        table = Table(title=Text(short_name(str(source)), "bold"), padding=(0, 1, 0, 0))
        table.add_column("")
        for column in columns:
            table.add_column(column, justify="right")
        for row in own.itertuples():
            figures = (row.ate_keyframes_m, row.ate_frames_m, row.rpe_m)
            table.add_row(
                row.system,
                f"{row.intact} of {row.runs}",
                str(row.ended_badly or "-"),
                number(row.breakages, 0),
                f"{row.false} / {row.declared}" if row.declared else "-",
                *map(number, figures),
                share(row.completeness),
                number(row.cpu_ms_median, 1),
            )
        yield table
