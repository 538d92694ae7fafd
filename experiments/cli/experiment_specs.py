"""``dslab experiment list`` and ``show``: what there is to run, what was run, and what it is."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dslab.experiments.cli.console import print_rows, print_yaml
from dslab.experiments.cli.experiment_claims import claim_folder_row, claim_rows, show_claim
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec

_FIRST_PART = re.compile(r"(?<!Eq)[.:?](?: |$)")


def list_command(
    place: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder under which experiments are looked for.")
    ] = Path(),
) -> None:
    """List the experiments that come with dslab, and the folders of those that were run.

    For example:

    `dslab experiment list out`
    """
    from dslab.experiments.campaign.overview import experiments_under
    from dslab.experiments.eq1.spec import PRESET_DIR, preset_names, read_spec_file, validated
    from dslab.scenarios.input_files import is_folder

    if not is_folder(place):
        raise InputError(str(place), "is no folder", "give the folder that holds those of experiments")

    def preset(name: str) -> dict[str, Any]:
        file = read_spec_file(PRESET_DIR / f"{name}.yaml")
        spec = validated(file.data, file)
        return {
            "experiment": name,
            "units": len(spec.cells) * spec.units,
            "takes": _takes(spec),
            "what it is": first_part(spec.description),
        }

    print_rows([*map(preset, preset_names()), *claim_rows()])
    if found := list(map(_folder, experiments_under(place))):
        print_rows(found)


def first_part(description: str) -> str:
    """The first part of a description: to its first full stop, colon or question mark."""
    return _FIRST_PART.split(" ".join(description.split()))[0]


def _folder(folder: Path) -> dict[str, Any]:
    from dslab.experiments.campaign.status import experiment_status
    from dslab.experiments.claims.loading import is_claim

    try:
        if is_claim(folder):
            return claim_folder_row(folder)
        status = experiment_status(folder)
    except InputError as error:
        return {"folder": folder, "experiment": None, "state": error.problem, "units": None}
    state = "finished" if status.finished else "not finished"
    name = f"{status.name}, a boundary search" if status.is_search else status.name
    return {
        "folder": folder,
        "experiment": name,
        "state": state,
        "units": f"{status.done} / {status.total}",
    }


def show_command(
    experiment: Annotated[
        str,
        typer.Argument(metavar="NAME|SPEC.yaml|DIR", help="A preset, a spec file or a folder that was run."),
    ],
) -> None:
    """Print the file of an experiment, with its cells, units and expected time in words above it.

    It is YAML to start your own from. For example:

    `dslab experiment show smoke > mine.yaml`
    """
    from dslab.experiments.campaign.folder import SPEC_FILE, read_rows
    from dslab.experiments.campaign.status import experiment_status
    from dslab.experiments.claims.loading import claim_presets, is_claim
    from dslab.experiments.eq1.spec import PRESET_DIR, load_spec, preset_names
    from dslab.scenarios.input_files import SETTINGS_BYTES, is_folder, read_text

    if is_claim(experiment):
        show_claim(experiment)
        return
    path = PRESET_DIR / f"{experiment}.yaml" if experiment in preset_names() else Path(experiment)
    if is_folder(path):
        status, (spec, rows) = experiment_status(path), read_rows(path)
        state = [f"{status.done} of {status.total} units are done"]
        path = path / SPEC_FILE
    else:
        spec, rows, state = load_spec(experiment, claim_presets()), [], []
    text = read_text(path, SETTINGS_BYTES, "check the path")
    print_yaml("".join(f"# {line}\n" for line in [*_about(spec, rows), *state]) + text)


def _about(spec: "ExperimentSpec", rows: list[dict[str, Any]]) -> list[str]:
    from dslab.experiments.eq1.boundary_plan import is_search
    from dslab.experiments.report.conditions import conditions, describe_base
    from dslab.experiments.report.describe import plural

    each = (
        (spec.worlds, "world"),
        (spec.sequences_per_world, "sequence"),
        (spec.repeats, "repeat"),
    )
    sizes = " × ".join(plural(count, noun) for count, noun in each)
    cells = f"{spec.name}: {plural(len(spec.cells), 'cell')} of {plural(spec.units, 'unit')} ({sizes})"
    if is_search(spec):
        cells = (
            f"{spec.name}: a boundary search of {plural(spec.worlds, 'trial')}, each in one of these cells"
        )
    lines = [cells if is_search(spec) else f"{cells}, {_takes(spec, rows)}"]
    of_base: dict[str, str] = {}
    for name, cell in spec.cells.items():
        of_base.setdefault(cell.base, name)
    for base, cell in of_base.items():
        lines.append(f"{base}: {'; '.join(describe_base(spec, cell).values())}")
    return lines + [f"{found['cell']}: {found['name']}" for found in conditions(spec)]


def _takes(spec: "ExperimentSpec", rows: list[dict[str, Any]] | None = None) -> str:
    """The expected time with a worker on every core, in words."""
    from dslab.experiments.campaign.overview import expected_worker_s

    return in_words(expected_worker_s(spec, rows or ()))


def in_words(worker_s: float) -> str:
    """Worker time as the time that it takes with a worker on every core."""
    from dslab.experiments.runs.provenance import usable_cores

    cores = usable_cores()
    minutes = worker_s / cores / 60
    hours = minutes / 60
    time = (
        f"{minutes:.0f} min" if hours < 1.5 else f"{hours:.0f} h" if hours < 48 else f"{hours / 24:.0f} days"
    )
    return f"about {time} on {cores} core{'' if cores == 1 else 's'}"
