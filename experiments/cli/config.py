"""``dslab config``."""

import typer

from dslab.experiments.cli.console import print_schema

app = typer.Typer(
    no_args_is_help=True, help="Settings of the SLAM: see them all, check files against their schema."
)


@app.command("show")
def show_command() -> None:
    """Print every setting with its default and description, as a file for `dslab run --config`.

    For example: `dslab config show > slam.yaml`
    """
    from dslab.experiments.runs.slam_settings import settings_yaml

    print(settings_yaml(), end="")


@app.command("schema")
def schema_command() -> None:
    """Print the JSON Schema of a settings file.

    For example: `dslab config schema > slam.schema.json`
    """
    from dslab.experiments.runs.slam_settings import settings_schema

    print_schema(settings_schema())
