"""The ``dslab`` command."""

import os
import sys
from importlib import metadata
from typing import Annotated

import typer

from experiments.cli import bench, config, demo, doctor, experiment, run, view, vocabulary, warmup
from experiments.cli.console import err
from experiments.cli.degrade import degrade_command
from experiments.cli.export import export_command
from experiments.cli.paper import paper_command
from experiments.cli.render import render_command
from experiments.cli.scenarios import app as scenarios_app
from experiments.plugins import load_plugins
from scenarios.errors import InputError

app = typer.Typer(
    name="dslab",
    help="Synthetic stress tests for monocular SLAM and Dual-SLAM: render, run, judge, look.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(demo.demo_command)
app.command("doctor")(doctor.doctor_command)
app.command("warmup")(warmup.warmup_command)
app.add_typer(scenarios_app, name="scenarios")
app.add_typer(config.app, name="config")
app.command("render")(render_command)
app.command("degrade")(degrade_command)
app.command("export")(export_command)
app.command("run")(run.run_command)
app.command("view")(view.view_command)
app.add_typer(experiment.app, name="experiment")
app.command("paper")(paper_command)
app.add_typer(bench.app, name="bench")
app.add_typer(vocabulary.app, name="vocabulary")


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"dual-slam-lab {metadata.version('dual-slam-lab')}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Entry point: bad input is one line and exit code 2, an interruption one line and 130."""
    # OpenCV's own warnings would stand beside the one line.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    try:
        load_plugins()
        app()
    except InputError as error:
        _say(f"error: {error}")
        sys.exit(2)
    except SystemExit as exit_:
        if exit_.code == 130:
            _say("interrupted: nothing half-written is left")
        raise


def _say(line: str) -> None:
    err.print(line.replace("\n", " "), markup=False, soft_wrap=True)
