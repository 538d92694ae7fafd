"""``dslab scenarios``: list, show, check and draw scenarios and their families."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.padding import Padding
from rich.text import Text

from dslab.experiments.cli.console import (
    FolderOption,
    WorkersOption,
    out,
    print_error_line,
    print_rows,
    print_schema,
    print_yaml,
    progress_bars,
    say,
    single_threaded_opencv,
)
from dslab.scenarios.errors import InputError, collect

if TYPE_CHECKING:
    from dslab.scenarios.families import Family

CHECKED_SEEDS = 20
MOST_FAULTS = 50

app = typer.Typer(
    no_args_is_help=True,
    help="List, show, check and draw scenarios, which are YAML files.",
)


@app.command("list")
def list_scenarios(
    everything: Annotated[
        bool, typer.Option("--all", help="Describe every family in full, with its members and what is drawn.")
    ] = False,
) -> None:
    """List the scenarios and families of dslab.

    Members of a family are named FAMILY/MEMBER; with FAMILY alone the seed selects the member.

    For example:

    `dslab scenarios list`
    """
    from dslab.scenarios.families import library_names, load_family

    families = {name: load_family(name) for name in library_names()}
    if everything:
        for name, family in families.items():
            _print_family(name, family)
        return
    print_rows(
        {
            "family": name,
            "members": len(family.members) or None,
            "what it is": re.split(r"[.:](?: |$)", family.description)[0],
        }
        for name, family in families.items()
    )


def _print_family(name: str, family: "Family") -> None:
    """Print description, members and drawn parameters."""
    from dslab.scenarios.describe_family import describe_parameters

    parts = [family.description]
    if family.members:
        parts.append(f"members: {', '.join(f'{name}/{member}' for member in family.members)}")
    if drawn := [f"{field}: {words}" for field, words in describe_parameters(family).items()]:
        parts.append("\n".join(["drawn by the seed:", *drawn]))
    out.print(Text(name, "bold"))
    for text in parts:
        out.print(Padding(text, (0, 0, 0, 2)))
    out.print()


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

    Example: `dslab scenarios show kitti-like/07 --seed 3 > mine.yaml`
    """
    from dslab.scenarios.families import load_family
    from dslab.scenarios.loading import dump_yaml

    family = load_family(scenario)
    print_yaml(family.as_yaml() if seed is None else dump_yaml(family.sample(seed)))


@app.command()
def validate(
    file: Annotated[Path, typer.Argument(help="A .yaml file.", metavar="FILE")],
) -> None:
    """Check a scenario or experiment file; exit code 2 and a line for every fault if it is not valid.

    From each member of a family, 20 scenarios are drawn; of an experiment, the first unit of every cell.

    Example: `dslab scenarios validate mine.yaml`
    """
    from dslab.scenarios.families import in_order_of_lines

    try:
        print(f"{file}: valid, {_valid_content(file)}")
    except InputError as error:
        faults = in_order_of_lines(file, error.faults)
        for fault in faults[:MOST_FAULTS]:
            print_error_line(f"error: {fault}")
        if len(faults) > MOST_FAULTS:
            print_error_line(f"and {len(faults) - MOST_FAULTS} more")
        raise typer.Exit(2) from None


def _valid_content(file: Path) -> str:
    """What a valid file holds. Raises InputError with every fault of another."""
    from dslab.scenarios.families import file_faults, load_family_file
    from dslab.scenarios.yaml_file import read_yaml

    if "bases" in read_yaml(file, faults=[]).data:
        from dslab.experiments.eq1.spec import load_spec

        spec = load_spec(file)
        return f"{spec.name}, an experiment, {len(spec.cell_names())} cells of {spec.units} units"
    collect(file_faults(file, CHECKED_SEEDS), None)
    family = load_family_file(file)
    if family.members or family.parameters:
        members = f"{len(family.members)} members, " if family.members else ""
        return f"{family.name}, a family, {members}drawn with {CHECKED_SEEDS} seeds each"
    scenario = family.sample(family.seed)
    segments = f"{len(scenario.segments)} segment{'' if len(scenario.segments) == 1 else 's'}"
    return f"{scenario.name}, {scenario.duration_s:g} s, {segments}"


@app.command()
def schema() -> None:
    """Print the JSON Schema of scenario files, for editors and other tools.

    Example: `dslab scenarios schema > scenario.schema.json`
    """
    from dslab.scenarios.schema import json_schema

    print_schema(json_schema())


@app.command()
def gallery(
    out_dir: FolderOption,
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Families, members or .yaml files; default: all of dslab.", metavar="NAME"),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Sequences per scenario, one seed each.")] = 3,
    frames: Annotated[int, typer.Option(min=1, max=100, help="Frames per sequence.")] = 8,
    workers: WorkersOption = 1,
) -> None:
    """Make a page of scenarios: thumbnails, a map of the path, segments, drawn parameters.

    The folder holds index.html and its pictures; it opens from the disk without a network. For example:

    `dslab scenarios gallery --out out/gallery --workers 2`
    """
    from dslab.experiments.gallery.build import make_gallery

    single_threaded_opencv()
    with progress_bars() as show:
        page = make_gallery(names or [], out_dir, seeds, frames, workers, show)
    say(str(page))
