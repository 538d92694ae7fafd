"""``dslab experiment``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.boundary import boundary_command
from dslab.experiments.cli.console import (
    JsonOption,
    SystemsOption,
    number,
    print_error_line,
    print_json_line,
    print_rows,
    print_schema,
    progress_bars,
    say,
)
from dslab.experiments.cli.experiment_answer import print_report, print_systems, print_warnings
from dslab.experiments.cli.experiment_claims import (
    claim_replay,
    claim_report,
    claim_status,
    refuse_claim,
    run_claim_command,
)
from dslab.experiments.cli.experiment_specs import list_command, show_command
from dslab.experiments.cli.experiment_units import unit_to_replay
from dslab.experiments.cli.fuzz import fuzz_command
from dslab.experiments.cli.proofs import power_command, prove_command
from dslab.experiments.cli.units import (
    MEMORY_MB,
    TIMEOUT_S,
    CoresOption,
    MemoryOption,
    RerunDamagedOption,
    RetryErrorsOption,
    TimeoutOption,
    estimates_text,
    unit_progress,
)
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec

_HELP = """Run many units with base and Dual-SLAM: run, resume, status, replay, report.

The folder of an experiment holds its spec, a ledger with one row per unit, and results. For example:

`dslab experiment run smoke --out out/smoke`

`dslab experiment report out/smoke`
"""
app = typer.Typer(help=_HELP, no_args_is_help=True)
app.command("list")(list_command)
app.command("show")(show_command)
app.command("boundary")(boundary_command)
app.command("fuzz")(fuzz_command)
app.command("power")(power_command)
app.command("prove")(prove_command)

FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of an experiment.")]


@app.command("merge")
def merge_command(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Folders of one experiment, or of its exported table."),
    ],
    out_dir: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder that gets their units.")],
) -> None:
    """Add the units of other folders to the ledger of a folder, which a run goes on from.

    For an experiment that several machines run, one from the first world on and one from the last
    (`--last-first`), or of which only the exported table is left. A unit that two of them hold must have the
    same outcome in both. For example:

    `dslab experiment merge docs/eq1 --out out/eq1`
    """
    from dslab.experiments.campaign.merge import merge
    from dslab.experiments.claims.loading import is_claim
    from dslab.experiments.claims.merge import merge_claims

    claims = {is_claim(source) for source in sources}
    if len(claims) > 1:
        raise InputError(str(sources[0]), "is of another kind than the others", "merge folders of one spec")
    done = merge_claims(out_dir, sources) if claims == {True} else merge(out_dir, sources)
    known = f", {done.known} were known with the same outcome" if done.known else ""
    say(f"{done.added} units added{known}: {done.done} of {done.total} in {out_dir}")


@app.command("run")
def run_command(
    experiment: Annotated[str, typer.Argument(metavar="NAME|SPEC.yaml", help="A preset or a spec file.")],
    out_dir: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the experiment.")],
    workers: CoresOption = None,
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
    timeout: TimeoutOption = TIMEOUT_S,
    memory: MemoryOption = MEMORY_MB,
    retry_errors: RetryErrorsOption = False,
    rerun_damaged: RerunDamagedOption = False,
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

    `dslab experiment run eq1-full --out out/full --scheduler tcp://10.0.0.1:8786`
    """
    from functools import partial

    from dslab.experiments.campaign.runner import run_experiment
    from dslab.experiments.campaign.schedule import Schedule
    from dslab.experiments.campaign.workers import unit_workers
    from dslab.experiments.claims.loading import claim_presets, is_claim
    from dslab.experiments.eq1.spec import load_spec

    if is_claim(experiment):
        of_workers = (workers, scheduler, timeout, memory)
        run_claim_command(experiment, out_dir, worlds, of_workers, last_first, rerun_damaged, as_json)
        return
    spec = load_spec(experiment, claim_presets())
    if worlds is not None:
        spec = spec.model_copy(update={"worlds": worlds})
    units = unit_workers(spec, systems_dir or (), workers, scheduler, timeout, memory)
    _tell_idle_cells(spec, out_dir)
    order = partial(Schedule, last_first=last_first)
    with unit_progress(spec.name, out_dir) as show:
        tally = run_experiment(
            spec, out_dir, units.open, retry_errors, rerun_damaged, show, order, units.digests
        )
    if as_json:
        status_command(out_dir, as_json=True)
        return
    say(f"{tally.done} of {tally.total} units: {estimates_text(tally)}")
    _print_systems_of(out_dir)
    if tally.retries:
        say(f"{tally.retries} attempts ended in infrastructure errors: see dslab experiment status {out_dir}")
    say(f"next: dslab experiment report {out_dir}")
    if tally.errors:
        say(
            f"{tally.errors} of {tally.done} units were given up, most for: {tally.cause}; "
            "mend it and run the same command again with --retry-errors"
        )


def _print_systems_of(folder: Path) -> None:
    """Print what the report will say of systems that are compared, and of any that fails without stress."""
    from dslab.experiments.campaign.folder import read_experiment
    from dslab.experiments.report.conditions import conditions
    from dslab.experiments.report.systems import beside_each_other, sham_warnings

    spec, table = read_experiment(folder)
    print_warnings(sham_warnings(table, len(spec.threads), folder))
    if beside := beside_each_other(spec, table):
        print_systems(beside, conditions(spec))


def _tell_idle_cells(spec: "ExperimentSpec", folder: Path) -> None:
    """Draw some worlds of an experiment that has not begun, and name the cells whose stress seldom acts."""
    from dslab.experiments.campaign.exposure import draw_exposure
    from dslab.experiments.jobs.ledger import LEDGER_FILE

    if (folder / LEDGER_FILE).exists():
        return
    with progress_bars(kernels=False) as progress:
        drawn = draw_exposure(spec, progress)
    for cell in drawn:
        if not cell.is_exposed:
            print_error_line(
                f"{cell.cell}: the stress acts in {cell.acted} of {cell.drawn} sequences drawn, the others "
                "would not count; give a stronger dose, or low_texture a view_share"
            )


@app.command("status")
def status_command(folder: FolderArgument, as_json: JsonOption = False) -> None:
    """Show the progress of an experiment, also while it runs, or what a published table holds.

    For example:

    `dslab experiment status out/smoke`
    """
    from dataclasses import asdict

    from dslab.experiments.campaign.status import experiment_status
    from dslab.experiments.claims.loading import is_claim

    if is_claim(folder):
        claim_status(folder, as_json)
        return
    status = experiment_status(folder)
    if as_json:
        print_json_line(asdict(status))
        return
    print_rows(
        (
            {
                "cell": cell.cell,
                "units": cell.units if cell.budget is None else f"{cell.units} / {cell.budget}",
                "count": cell.completed,
                "not\nexposed": cell.unexposed,
                "void": cell.void,
                "errors": cell.errors,
                "break": cell.breakages,
                "threads\nfail": cell.dual_failures,
                "system\nfails": cell.system_failures,
            }
            for cell in status.cells
        ),
        f"{status.name} ({status.spec_hash[:12]})",
    )
    what = "trials of the search" if status.is_search else "units"
    finished = ", finished" if status.finished else ""
    hours = number(status.wall_s / 3600, 2)
    say(f"{status.done} of {status.total} {what}{finished}, {hours} h of worker time")
    if status.failed_attempts:
        say(f"{status.failed_attempts} attempts ended in infrastructure errors")
    for unit_id, message in status.given_up:
        say(f"given up: {unit_id}: {message}")
    if len(status.codes) > 1:
        say(f"units were run with {len(status.codes)} versions of the code: {', '.join(status.codes)}")


@app.command("replay")
def replay_command(
    folder: FolderArgument,
    unit: Annotated[
        str | None,
        typer.Argument(
            help="Id of the unit or a unique prefix, or CELL:INDEX; of an experiment on a claim its number. "
            "Without it some are listed."
        ),
    ] = None,
    outcome: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Instead of UNIT: the first of whose outcome this is a part."),
    ] = None,
    rerun: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="Save a recording of its arms for `dslab view`.")
    ] = None,
    systems_dir: SystemsOption = None,
    timeout: TimeoutOption = TIMEOUT_S,
    memory: MemoryOption = MEMORY_MB,
    as_json: JsonOption = False,
) -> None:
    """Replay one unit and compare it with the ledger or the published table; exit code 1 if they differ.

    Without a unit, the first that fails in each condition is listed, with the command that replays it. For
    example:

    `dslab experiment replay out/smoke`

    `dslab experiment replay out/smoke --outcome "dual failure"`

    `dslab experiment replay docs/eq1 corridor/low_texture/1:7 --rerun unit.rrd`
    """
    from dslab.experiments.campaign.replay import replay
    from dslab.experiments.campaign.workers import UnitWorkers
    from dslab.experiments.claims.loading import is_claim
    from dslab.experiments.jobs.pool import PoolSettings

    if is_claim(folder):
        if not claim_replay(folder, unit, None if rerun is None else rerun.absolute()):
            raise typer.Exit(1)
        return
    if unit is not None and outcome is not None:
        raise InputError("--outcome", f"the unit {unit} is named already", "give one of them")
    unit = unit or unit_to_replay(folder, outcome)
    if unit is None:
        return
    folders = tuple(folder.absolute() for folder in systems_dir or ())
    workers = UnitWorkers(PoolSettings(1, None, timeout, memory or None), folders)
    with progress_bars() as show:
        show(f"unit {unit}", 0, 1)
        done = replay(folder, unit, workers, None if rerun is None else rerun.absolute())
    if done.origin:
        print_error_line(done.origin)
    record, of = done.record, done.unit
    if as_json:
        print_json_line({"record": record, "recorded": done.recorded, "differing": done.differing})
    else:
        say(f"unit {of.unit_id} ({of.cell}:{of.index}): {record['outcome']} {record['message']}")
        if done.recorded is None:
            say("not yet in the ledger")
        elif not done.differing:
            say("agrees with the ledger in every column except time and memory")
        for name in done.differing:
            say(f"{name}: {record[name]!r}, in the ledger {(done.recorded or {})[name]!r}")
        if rerun is not None and rerun.is_file():
            say(f"open it: dslab view {rerun}")
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

    refuse_claim(folder, "export")
    say(f"one row per unit in {export(folder, csv)}")


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
    from dslab.experiments.claims.loading import is_claim
    from dslab.experiments.report.write import FIGURES, write_report
    from dslab.scenarios.input_files import read_json

    if is_claim(folder):
        claim_report(folder)
        return
    with progress_bars() as show:
        show("figures", 0, 1)
        path = write_report(folder, recordings, lambda done, total: show("recordings", done, total))
    print_report(read_json(folder / FIGURES, dict))
    say(f"report in {path}")


@app.command("schema")
def schema_command() -> None:
    """Print the JSON Schema of experiment files, for editors.

    For example:

    `dslab experiment schema > experiment.schema.json`
    """
    from dslab.experiments.eq1.spec_schema import json_schema

    print_schema(json_schema())
