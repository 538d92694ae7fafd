"""``dslab config``."""

import typer

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Settings of the SLAM."""


@app.command("show")
def show_command() -> None:
    """Print every setting with its default and description, as a file for `dslab run --config`.

    For example: `dslab config show > slam.yaml`
    """
    from dslab.experiments.runs.slam_settings import settings_yaml

    print(settings_yaml(), end="")
