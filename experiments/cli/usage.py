"""Words of a command line that do not fit, as one line."""

import sys

import typer

from dslab.scenarios.errors import InputError

_UsageError: type[Exception] = typer.BadParameter.__mro__[1]  # Typer exports only this child of it


def run_app(app: typer.Typer) -> None:
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
