"""``dslab scenarios``: list, show, check and draw scenarios and their families."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.syntax import Syntax
from rich.table import Table
from rich.text import Text

from experiments.cli.console import out
from experiments.cli.gallery import gallery_command

CHECKED_SEEDS = 20

app = typer.Typer(
    no_args_is_help=True,
    help="List, show, check and draw scenarios, which are YAML files.",
    rich_markup_mode="rich",
)


@app.command("list")
def list_scenarios() -> None:
    """List the scenarios and families of dslab.

    Members of a family are named FAMILY/MEMBER; with FAMILY alone the seed selects the member.

    Example: [bold]dslab scenarios list[/bold]
    """
    from scenarios.describe_family import describe_members, describe_parameters
    from scenarios.families import library_names, load_family

    table = Table("family", "members", "drawn by the seed", show_lines=True)
    for name in library_names():
        family = load_family(name)
        title = Text.assemble((name, "bold"), "\n", family.description)
        drawn = [f"{field}: {words}" for field, words in describe_parameters(family).items()]
        table.add_row(title, describe_members(family) or "-", "\n".join(drawn) or "-")
    out.print(table)


@app.command()
def show(
    scenario: Annotated[str, typer.Argument(help="Name or .yaml file.", metavar="NAME")],
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Draw with this seed and write out every default.", show_default=False),
    ] = None,
) -> None:
    """Print a scenario or family as written, or the scenario drawn with a seed.

    Either is YAML to start your own from.

    Example: [bold]dslab scenarios show kitti-like/07 --seed 3 > mine.yaml[/bold]
    """
    from scenarios.families import load_family
    from scenarios.loading import dump_yaml

    family = load_family(scenario)
    text = family.as_yaml() if seed is None else dump_yaml(family.sample(seed))
    if out.is_terminal:
        out.print(Syntax(text, "yaml", background_color="default"))
    else:
        print(text, end="")


@app.command()
def validate(
    file: Annotated[Path, typer.Argument(help="A .yaml file.", metavar="FILE")],
) -> None:
    """Check a scenario file; exit code 2 and one line if it is not valid.

    From each member of a family, 20 scenarios are drawn.

    Example: [bold]dslab scenarios validate mine.yaml[/bold]
    """
    from scenarios.families import load_family_file

    family = load_family_file(file)
    everyone = [family.member(member) for member in family.members] or [family]
    for one in everyone:
        seeds = range(one.seed, one.seed + CHECKED_SEEDS) if one.parameters else [one.seed]
        for seed in seeds:
            one.sample(seed)
    if family.members or family.parameters:
        members = f"{len(family.members)} members, " if family.members else ""
        print(f"{file}: valid, {family.name}, a family, {members}drawn with {CHECKED_SEEDS} seeds each")
        return
    scenario = family.sample(family.seed)
    segments = f"{len(scenario.segments)} segment{'' if len(scenario.segments) == 1 else 's'}"
    print(f"{file}: valid, {scenario.name}, {scenario.duration_s:g} s, {segments}")


@app.command()
def schema() -> None:
    """Print the JSON Schema of scenario files, for editors and other tools.

    Example: [bold]dslab scenarios schema > scenario.schema.json[/bold]
    """
    from scenarios.schema import json_schema

    print(json.dumps(json_schema(), indent=2))


app.command("gallery")(gallery_command)
