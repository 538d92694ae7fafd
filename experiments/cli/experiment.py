"""``dslab experiment``."""

from pathlib import Path
from typing import Annotated

import typer

from dslab.experiments.cli.boundary import boundary_command
from dslab.experiments.cli.console import (
    JsonOption,
    SystemsOption,
    err,
    number,
    out,
    print_json_line,
    print_table,
    progress_bars,
)
from dslab.experiments.cli.experiment_progress import estimates_text, experiment_progress
from dslab.experiments.cli.experiment_tables import print_answer, print_replay, status_table
from dslab.experiments.cli.exposure import tell_idle_cells
from dslab.experiments.cli.fuzz import fuzz_command
from dslab.experiments.cli.merge import merge_command

_HELP = """Run many units with base and Dual-SLAM: run, resume, status, replay, report.

The folder of an experiment holds its spec, a ledger with one row per unit, and results. For example:

`dslab experiment run smoke --out out/smoke`

`dslab experiment report out/smoke`
"""
app = typer.Typer(help=_HELP, no_args_is_help=True)
app.command("boundary")(boundary_command)
app.command("fuzz")(fuzz_command)
app.command("merge")(merge_command)

FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of an experiment.")]
TimeoutOption = Annotated[float, typer.Option(min=1, help="Time limit of a unit in seconds.")]
MemoryOption = Annotated[
    int,
    typer.Option(min=0, metavar="MB", help="Memory limit of a worker; a unit above it is retried; 0: none."),
]
_TIMEOUT_S, _MEMORY_MB = 1800.0, 4000  # as of experiments.campaign.workers, which is slow to import


@app.command("run")
def run_command(
    experiment: Annotated[str, typer.Argument(metavar="NAME|SPEC.yaml", help="A preset or a spec file.")],
    out_dir: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the experiment.")],
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one per core.")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Dask scheduler to use instead of processes of this machine."),
    ] = None,
    worlds: Annotated[
        int | None, typer.Option(min=1, help="Worlds of every cell instead of those of the spec.")
    ] = None,
    last_first: Annotated[
        bool,
        typer.Option(
            "--last-first",
            help="Begin with the last world: on a second machine, see `dslab experiment merge`.",
        ),
    ] = False,
    systems_dir: SystemsOption = None,
    timeout: TimeoutOption = _TIMEOUT_S,
    memory: MemoryOption = _MEMORY_MB,
    retry_errors: Annotated[
        bool,
        typer.Option("--retry-errors", help="Retry units that were given up for infrastructure errors."),
    ] = False,
    rerun_damaged: Annotated[
        bool,
        typer.Option("--rerun-damaged", help="Drop damaged rows of the ledger and run their units again."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run or resume an experiment; units that the folder already holds are not run again.

    Systems of other people run the free arm, on the same frames as ours; with one that takes frames in real
    time, units run one at a time.

    Before the first unit ten worlds of every cell are drawn. Where the stress acts in fewer than nine, that
    is told: the other units would stand beside those without stress.

    It may be interrupted at any time, also by `kill -9`: only running units are lost. The rows are the same
    for any number of workers. The exit code is 1 if the run stops for a fault of the machine, or if every
    unit was given up; units given up among others are counted in the last line. For example:

    `dslab experiment run smoke --out out/smoke`

    `dslab experiment run my-spec.yaml --out out/mine --workers 8 --worlds 100`

    `dslab experiment run eq1-full --out out/full --scheduler tcp://10.0.0.1:8786`
    """
    from functools import partial

    from dslab.experiments.campaign.runner import run_experiment
    from dslab.experiments.campaign.schedule import Schedule
    from dslab.experiments.campaign.workers import unit_workers
    from dslab.experiments.eq1.spec import load_spec

    spec = load_spec(experiment)
    if worlds is not None:
        spec = spec.model_copy(update={"worlds": worlds})
    units = unit_workers(spec, systems_dir or (), workers, scheduler, timeout, memory)
    tell_idle_cells(spec, out_dir)
    try:
        with experiment_progress(spec.name) as show:
            tally = run_experiment(
                spec,
                out_dir,
                units.open,
                retry_errors,
                rerun_damaged,
                show,
                order=partial(Schedule, last_first=last_first),
                digests=units.digests,
            )
    except KeyboardInterrupt:
        err.print(f"{out_dir} keeps the finished units: run the same command again to resume", soft_wrap=True)
        raise
    if as_json:
        status_command(out_dir, as_json=True)
        return
    out.print(f"{tally.done} of {tally.total} units: {estimates_text(tally)}")
    if tally.retries:
        out.print(
            f"{tally.retries} attempts ended in infrastructure errors: see dslab experiment status {out_dir}",
            soft_wrap=True,
        )
    out.print(f"next: dslab experiment report {out_dir}", soft_wrap=True)
    if tally.errors:
        out.print(
            f"{tally.errors} of {tally.done} units were given up, most for: {tally.cause}; "
            "mend it and run the same command again with --retry-errors",
            markup=False,
            soft_wrap=True,
        )


@app.command("status")
def status_command(folder: FolderArgument, as_json: JsonOption = False) -> None:
    """Show the progress of an experiment, also while it runs, or what a published table holds.

    For example:

    `dslab experiment status out/smoke`
    """
    from dataclasses import asdict

    from dslab.experiments.campaign.status import experiment_status
    from dslab.experiments.runs.files import plain

    status = experiment_status(folder)
    if as_json:
        print_json_line(plain(asdict(status)))
        return
    print_table(status_table(status))
    out.print(f"{status.done} of {status.total} units, {number(status.wall_s / 3600, 2)} h of worker time")
    if status.failed_attempts:
        out.print(f"{status.failed_attempts} attempts ended in infrastructure errors")
    for unit_id, message in status.given_up:
        out.print(f"given up: {unit_id}: {message}")
    if len(status.codes) > 1:
        out.print(f"units were run with {len(status.codes)} versions of the code: {', '.join(status.codes)}")


@app.command("power")
def power_command(
    p0: Annotated[float, typer.Option(help="Assumed share of units with a breakage.")],
    pr: Annotated[
        list[float], typer.Option(help="Assumed failure rate of a recovery thread; repeat for each of n.")
    ],
    n: Annotated[
        int | None, typer.Option(min=1, max=6, help="Number of threads, if one pr is given for all.")
    ] = None,
    ratio: Annotated[float, typer.Option(help="Ratio of measured to predicted failures to detect.")] = 2.0,
    worlds: Annotated[
        int | None, typer.Option(min=3, max=2000, help="Worlds; default: as many as the power takes.")
    ] = None,
    power: Annotated[float, typer.Option(help="Wanted probability of detection, without --worlds.")] = 0.8,
    sequences: Annotated[int, typer.Option(min=1, max=20, help="Sequences per world.")] = 1,
    replicates: Annotated[int, typer.Option(min=1, max=20, help="Replicates per sequence.")] = 3,
    icc: Annotated[float, typer.Option(help="Share of an outcome that the world determines.")] = 0.6,
    tests: Annotated[int, typer.Option(min=1, max=100, help="Tests under one Holm correction.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Simulate the tests of Eq. 1, and print their power, or the worlds that a power takes.

    For example:

    `dslab experiment power --p0 0.25 --pr 0.2 --n 2 --ratio 2 --power 0.8`

    `dslab experiment power --p0 0.5 --pr 0.5 --ratio 1.29 --worlds 100 --tests 9`
    """
    from dataclasses import asdict

    from dslab.experiments.statistics.power import MOST_WORLDS, Design, power_of, worlds_needed
    from dslab.scenarios.errors import InputError

    if n is not None and len(pr) not in (1, n):
        raise InputError(
            "--n", f"is {n}, but {len(pr)} values of --pr are given", "give one --pr, or n of them"
        )
    each = tuple(pr * n) if n is not None and len(pr) == 1 else tuple(pr)
    design = Design(worlds or MOST_WORLDS, sequences, replicates, icc, tests)
    try:
        if worlds is None:
            found = worlds_needed(p0, each, ratio, power, design)
        else:
            found = power_of(p0, each, ratio, design)
    except ValueError as error:
        raise InputError("dslab experiment power", str(error), "give other assumptions") from None
    if as_json:
        print_json_line({} if found is None else asdict(found))
        return
    if found is None:
        out.print(f"more than {MOST_WORLDS} worlds would be needed")
        return
    out.print(f"predicted {found.predicted:.4g}; {ratio:g} times as high: {found.measured:.4g}")
    out.print(
        f"{found.design.worlds} worlds: power {found.independence:.2f} of the test of independence, "
        f"{found.forecast:.2f} of the forecast (standard error {found.error:.2f})"
    )


@app.command("prove")
def prove_command(
    experiments: Annotated[int, typer.Option(min=20, help="Simulated experiments per claim.")] = 2000,
    only: Annotated[str, typer.Option(metavar="TEXT", help="Only claims with this in their name.")] = "",
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Root seed of the draws.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Simulate experiments with known answers, and print how often the statistics give them.

    The figures are the same for any number of workers. The exit code is 1 if a claim does not hold.
    For example:

    `dslab experiment prove --experiments 100`

    `dslab experiment prove --only coverage --workers 2`
    """
    from dataclasses import asdict

    from rich.table import Table

    from dslab.experiments.statistics.proofs import claims, prove
    from dslab.scenarios.errors import InputError

    total = sum(only in claim.name for claim in claims())
    if total == 0:
        raise InputError("--only", f"no claim has {only!r} in its name", "leave it out to see all names")
    proofs = []
    with progress_bars() as show:
        show("claims", 0, total)
        for proof in prove(experiments, seed, workers, only):
            proofs.append(proof)
            show("claims", len(proofs), total)
    if as_json:
        for proof in proofs:
            print_json_line({**asdict(proof), "holds": proof.holds()})
    else:
        table = Table("claim", "asked", "found", "error", "holds")
        for proof in proofs:
            asked = f"{number(proof.low)} to {number(proof.high)}"
            figures = (asked, number(proof.found), number(proof.error))
            table.add_row(proof.name, *figures, "yes" if proof.holds() else "no")
        print_table(table)
    if not all(proof.holds() for proof in proofs):
        raise typer.Exit(1)


@app.command("replay")
def replay_command(
    folder: FolderArgument,
    unit: Annotated[str, typer.Argument(help="Id of the unit or a unique prefix, or CELL:INDEX.")],
    rerun: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="Save a recording for `dslab view`.")
    ] = None,
    systems_dir: SystemsOption = None,
    timeout: TimeoutOption = _TIMEOUT_S,
    memory: MemoryOption = _MEMORY_MB,
    as_json: JsonOption = False,
) -> None:
    """Replay one unit and compare it with the ledger or the published table; exit code 1 if they differ.

    For example:

    `dslab experiment replay out/smoke 3fa9`

    `dslab experiment replay docs/eq1 corridor/low_texture/1:7 --rerun unit.rrd`
    """
    from dslab.experiments.campaign.replay import replay
    from dslab.experiments.campaign.workers import UnitWorkers
    from dslab.experiments.jobs.pool import PoolSettings
    from dslab.experiments.runs.files import plain

    folders = tuple(folder.absolute() for folder in systems_dir or ())
    workers = UnitWorkers(PoolSettings(1, None, timeout, memory or None), folders)
    with progress_bars() as show:
        show(f"unit {unit}", 0, 1)
        done = replay(folder, unit, workers, None if rerun is None else rerun.absolute())
    if done.origin:
        err.print(done.origin, markup=False, soft_wrap=True)
    if as_json:
        print_json_line(
            plain({"record": done.record, "recorded": done.recorded, "differing": done.differing})
        )
    else:
        print_replay(done, rerun)
    if done.differing:
        raise typer.Exit(1)


@app.command("export")
def export_command(
    folder: FolderArgument,
    csv: Annotated[bool, typer.Option("--csv", help="Write units.csv too.")] = False,
) -> None:
    """Write the ledger as units.parquet, one row per unit, and a file of infrastructure errors.

    For example:

    `dslab experiment export out/smoke --csv`
    """
    from dslab.experiments.campaign.folder import export

    out.print(f"one row per unit in {export(folder, csv)}", soft_wrap=True)


@app.command("report")
def report_command(
    folder: FolderArgument,
    recordings: Annotated[
        int, typer.Option(min=0, help="Number of failed units to replay; the report links their recordings.")
    ] = 0,
) -> None:
    """Write report.html, report.json and plots into the folder of an experiment, and print the answer.

    For example:

    `dslab experiment report out/smoke --recordings 3`
    """
    from dslab.experiments.report.write import FIGURES, write_report
    from dslab.scenarios.input_files import read_json

    with progress_bars() as show:
        path = write_report(folder, recordings, lambda done, total: show("recordings", done, total))
    if answer := read_json(folder / FIGURES, dict).get("answer"):
        print_answer(answer)
    out.print(f"report in {path}", soft_wrap=True)


@app.command("schema")
def schema_command() -> None:
    """Print the JSON Schema of experiment files, for editors.

    For example:

    `dslab experiment schema > experiment.schema.json`
    """
    import json

    from dslab.experiments.eq1.spec_schema import json_schema

    print(json.dumps(json_schema(), indent=2))
