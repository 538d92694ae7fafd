"""``dslab scenarios``: see, check and export scenarios."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.syntax import Syntax
from rich.table import Table

app = typer.Typer(
    no_args_is_help=True,
    help="See, check and export scenarios: what happens, as YAML.",
    rich_markup_mode="rich",
)


@app.command("list")
def list_scenarios() -> None:
    """The scenarios that come with dslab."""
    from scenarios.loading import load_scenario, named_scenarios

    table = Table("scenario", "world", "duration", "segments", show_lines=True)
    for name in named_scenarios():
        scenario = load_scenario(name)
        segments = "\n".join(f"{s.kind}, {s.start_s:g}-{s.end_s:g} s" for s in scenario.segments)
        what = f"[bold]{name}[/bold]\n{scenario.description}"
        table.add_row(what, scenario.world.kind, f"{scenario.duration_s:g} s", segments or "-")
    Console().print(table)


@app.command()
def show(
    scenario: Annotated[str, typer.Argument(help="Name or .yaml file.", metavar="NAME")],
) -> None:
    """A scenario with every default written out, as YAML to start your own from.

    Example: [bold]dslab scenarios show stressed > mine.yaml[/bold]
    """
    from scenarios.loading import dump_yaml, load_scenario

    text = dump_yaml(load_scenario(scenario))
    console = Console()
    if console.is_terminal:
        console.print(Syntax(text, "yaml", background_color="default"))
    else:
        typer.echo(text, nl=False)


@app.command()
def validate(
    file: Annotated[Path, typer.Argument(help="A .yaml file.", metavar="FILE")],
) -> None:
    """Check a scenario file; exit code 2 and one line if it is not valid."""
    from scenarios.loading import load_scenario_file

    scenario = load_scenario_file(file)
    segments = f"{len(scenario.segments)} segment{'' if len(scenario.segments) == 1 else 's'}"
    typer.echo(f"{file}: valid, {scenario.name}, {scenario.duration_s:g} s, {segments}")


@app.command()
def schema() -> None:
    """The JSON Schema of a scenario file, for editors and other tools."""
    from scenarios.loading import json_schema

    typer.echo(json.dumps(json_schema(), indent=2))
