"""The ``dslab`` command."""

import os
import signal
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
from experiments.cli.signals import signals_as_interrupts
from experiments.cli.streams import safe_streams
from experiments.cli.usage import run_app
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


def main() -> None:
    """Entry point: bad input is one line and exit code 2, a signal 128 + its number."""
    # OpenCV's own warnings would stand beside the one line.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    with safe_streams(), signals_as_interrupts() as received:
        try:
            load_plugins()
            run_app(app)
        except BaseException as ending:
            if isinstance(ending, SystemExit) and not ending.code:
                raise
            # Once a signal has come, what else goes wrong comes of it: processes of the group end as well.
            if received or _is_interrupt(ending):
                number = received[0] if received else signal.SIGINT
                _clear_up()
                how = "interrupted" if number == signal.SIGINT else f"ended by {number.name}"
                _say(f"{how}: nothing half-written is left")
                sys.exit(128 + number)
            if isinstance(ending, InputError):
                _say(f"error: {ending}")
                sys.exit(ending.exit_code)
            raise


def _is_interrupt(ending: BaseException) -> bool:
    """An interrupt, as Typer passes it on."""
    return isinstance(ending, KeyboardInterrupt) or (
        isinstance(ending, SystemExit) and ending.code == 128 + signal.SIGINT
    )


def _clear_up() -> None:
    """Remove what this process and its workers, which were killed, had no time to."""
    from sim.cache import UNFINISHED, default_cache_dir
    from sim.unfinished import remove_own, sweep, sweep_scratch

    remove_own()
    sweep_scratch()
    sweep(default_cache_dir(), UNFINISHED)


def _say(line: str) -> None:
    err.print(line.replace("\n", " "), soft_wrap=True)
