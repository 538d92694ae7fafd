"""Every command of ``dslab``."""

import sys
from importlib import metadata
from typing import Annotated

import typer

from dslab.experiments.cli import belief, bench, cache, config, experiment, systems, vocabulary
from dslab.experiments.cli.batch import batch_command
from dslab.experiments.cli.camera import camera_command
from dslab.experiments.cli.compare import compare_command
from dslab.experiments.cli.degrade import degrade_command
from dslab.experiments.cli.demo import demo_command
from dslab.experiments.cli.doctor import doctor_command, warmup_command
from dslab.experiments.cli.evo import evo_command
from dslab.experiments.cli.export import export_command
from dslab.experiments.cli.footage import footage_command
from dslab.experiments.cli.paper import paper_command
from dslab.experiments.cli.picture import picture_command
from dslab.experiments.cli.run import run_command
from dslab.experiments.cli.scenarios import app as scenarios_app
from dslab.experiments.cli.view import view_command
from dslab.scenarios.errors import InputError

_UsageError: type[Exception] = typer.BadParameter.__mro__[1]  # Typer exports only this child of it

app = typer.Typer(
    name="dslab",
    help="Synthetic stress tests for monocular SLAM and Dual-SLAM: render, run, judge, look.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(demo_command)
app.command("doctor")(doctor_command)
app.command("warmup")(warmup_command)
app.add_typer(scenarios_app, name="scenarios")
app.add_typer(config.app, name="config")
app.add_typer(cache.app, name="cache")
app.command("degrade")(degrade_command)
app.command("export")(export_command)
app.command("camera")(camera_command)
app.command("run")(run_command)
app.add_typer(systems.app, name="systems")
app.command("batch")(batch_command)
app.command("compare")(compare_command)
app.command("evo")(evo_command)
app.command("footage")(footage_command)
app.command("view")(view_command)
app.command("picture")(picture_command)
app.add_typer(experiment.app, name="experiment")
app.command("paper")(paper_command)
app.add_typer(bench.app, name="bench")
app.add_typer(belief.app, name="belief")
app.add_typer(vocabulary.app, name="vocabulary")


def _print_version(requested: bool) -> None:
    if requested:
        print(f"dual-slam-lab {metadata.version('dual-slam-lab')}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    pass


def run_app() -> None:
    """Run this process's command line and end it with the command's exit code.

    Raises:
        InputError: a command, option or argument is unknown, missing or malformed.
    """
    try:
        code = app(prog_name="dslab", standalone_mode=False)
    except _UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            sys.exit(2)  # the help has been printed
        command = error.ctx.command_path if error.ctx else "dslab"
        problem = " ".join(error.format_message().split()).rstrip(".")
        raise InputError(command, problem[:1].lower() + problem[1:], f"see {command} -h") from None
    sys.exit(code)
