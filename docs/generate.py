"""Source of the documentation site: the pages of this folder, and what is made from the code.

    python docs/generate.py FOLDER

``<!-- made: NAME -->`` in a page stands for what the function NAME returns, ``<!-- code: FILE -->`` for code.
"""

import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from direct_pictures import draw_direct_pictures, shown
from pydantic import BaseModel
from stress_pictures import draw_pictures

from dslab.experiments.batch.rows import COLUMNS as BATCH_COLUMNS
from dslab.experiments.batch.spec import BatchSpec
from dslab.experiments.campaign.folder import read_experiment
from dslab.experiments.eq1.doses import AXES
from dslab.experiments.eq1.records import FAILURES, PAIR_COLUMNS, THREAD_COLUMNS, UNIT_COLUMNS
from dslab.experiments.eq1.spec import ExperimentSpec, load_spec, preset_names
from dslab.experiments.eq1.spec_parts import Base, Degradation
from dslab.experiments.report.content import report_content
from dslab.experiments.report.write import write_files
from dslab.experiments.runs.slam_settings import settings_yaml
from dslab.experiments.runs.systems.command_spec import CommandSpec, Environment, Limits
from dslab.scenarios.cameras import PRESETS as CAMERAS
from dslab.scenarios.cameras import Camera
from dslab.scenarios.describe import describe_kind, label_and_unit
from dslab.scenarios.describe_family import describe_parameters
from dslab.scenarios.families import library_names, load_family
from dslab.scenarios.imu import Imu
from dslab.scenarios.motions import KINDS as MOTIONS
from dslab.scenarios.motions import Trajectory
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.scenarios.worlds import WORLD_KINDS, Aliasing
from dslab.sim.degradations.recorded_kinds import recorded_sequence_kinds
from dslab.sim.degradations.registry import DEGRADATIONS

HERE = Path(__file__).parent
ROOT = HERE.parent
# Pages that stand at the root of the repository, and where their links lead on the site.
ROOT_PAGES = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md")
# Folders with the records of experiments, of which the site has the reports.
EXPERIMENTS = ("eq1", "eq1-doses", "eq1-vga", "eq1-quick")


direct_points, direct_alignment, direct_blur, direct_looks = (
    partial(shown, name) for name in ("points", "alignment", "blur", "looks")
)


def main(folder: Path) -> None:
    """Write the pages into a folder, which is emptied before."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(HERE, folder, ignore=shutil.ignore_patterns("*.py", "__pycache__", *EXPERIMENTS))
    draw_pictures(folder / "stress")
    draw_direct_pictures(folder / "direct")
    for name in EXPERIMENTS:
        write_experiment_report(name, folder / name)
    for page in folder.rglob("*.md"):
        text = page.read_text()
        text = re.sub(r"<!-- made: (\w+) -->", lambda found: globals()[found[1]](), text)
        page.write_text(re.sub(r"<!-- code: (\S+) -->", lambda found: code(found[1]), text))
    for name in ROOT_PAGES:
        (folder / name.lower()).write_text(on_the_site((ROOT / name).read_text()))


def write_experiment_report(name: str, folder: Path) -> None:
    """Write the report of an experiment's committed records, with its page and plots."""
    folder.mkdir()
    records = HERE / name
    write_files(report_content(*read_experiment(records), records.relative_to(ROOT)), folder)


def on_the_site(text: str) -> str:
    """The text of a page of the repository's root with links that lead to pages of the site."""
    text = text.replace("](docs/", "](")
    for name in ROOT_PAGES:
        text = text.replace(f"]({name}", f"]({name.lower()}")
    return text


def code(file: str) -> str:
    """A file as a block of code."""
    return f"```python\n{(ROOT / file).read_text()}```"


def eq1_reports() -> str:
    """Links to the reports of the experiments on Eq. 1."""
    names = [f"[{name}]({name}/report.html) ([figures]({name}/report.json))" for name in EXPERIMENTS]
    *now, former = names
    return f"The whole reports: {', '.join(now)}; of the first run, reanalysed: {former}."


def stress_kinds() -> str:
    """A section per kind of stress, in the order in which they act."""
    return "\n".join(_stress_kind(kind) for kind in DEGRADATIONS)


def _stress_kind(kind: str) -> str:
    name = describe_kind(kind)
    if kind in recorded_sequence_kinds(depth=False):
        where = "Rendered frames and recorded footage."
    elif kind in recorded_sequence_kinds(depth=True):
        where = "Rendered frames, and recorded footage that has depth images."
    else:
        where = "Rendered frames only."
    model, measure = SEGMENT_KINDS[kind], DEGRADATIONS[kind].measure_name
    ramp = (
        " Its severity may rise and fall over `ramp_s` (fall over `fall_s`)."
        if "ramp_s" in model.model_fields
        else ""
    )
    return f"""## {name.capitalize().replace("Jpeg", "JPEG")}

{_about(model)}

![{name}: without, with](stress/{kind}{".svg" if DEGRADATIONS[kind].stage.name == "TIMING" else ".jpg"})

**`{kind}`** · {where}{ramp} Measured on every frame as `{measure}`.

{_fields(model, ("kind", "start_s", "duration_s", "ramp_s", "fall_s"))}
"""


def worlds() -> str:
    """A section per kind of world."""
    return "\n".join(
        f"### {describe_kind(kind).capitalize()}\n\n`kind: {kind}`: {_about(model)}\n\n{_fields(model)}\n"
        for kind, model in WORLD_KINDS.items()
    )


def aliasing() -> str:
    """The fields of the option by which a world repeats itself."""
    return _fields(Aliasing, ())


def motions() -> str:
    """The fields of a trajectory, and the defaults that its kinds set."""
    rows = [
        (f"`{kind}`", ", ".join(f"`{name}: {value:g}`" for name, value in fields.items()) or "nothing")
        for kind, fields in MOTIONS.items()
    ]
    return _fields(Trajectory) + "\n" + _table(("kind", "sets"), rows)


def cameras() -> str:
    """The fields of a camera, and its presets."""
    columns = ("width_px", "height_px", "fx_px", "fps")
    rows = []
    for name, preset in CAMERAS.items():
        lens = preset.get("distortion", {}).get("model", "")
        rows.append((f"`{name}`", *(f"{preset[column]:g}" for column in columns), lens))
    return _fields(Camera) + "\n" + _table(("preset", *columns, "distortion"), rows)


def imu() -> str:
    """The fields of an inertial sensor."""
    return _fields(Imu, ())


def library() -> str:
    """Every family of scenarios that comes with dslab."""
    return "\n".join(map(_family, library_names()))


def _family(name: str) -> str:
    family = load_family(name)
    members = _members(list(family.members))
    drawn = ", ".join(f"`{field}` {words}" for field, words in describe_parameters(family).items())
    return " ".join(
        [
            f"- **`{name}`**{f' ({members})' if members else ''}.",
            " ".join(family.description.split()),
            f"*Drawn:* {drawn}." if drawn else "",
        ]
    )


def _members(names: list[str]) -> str:
    numbered = names and all(name.isdigit() for name in names)
    named = f"{names[0]} to {names[-1]}" if numbered else ", ".join(names)
    return f"{len(names)}: {named}" if names else ""


def presets() -> str:
    """Every experiment that comes with dslab."""
    return _table(
        ("preset", "what it asks"),
        [(f"`{name}`", load_spec(name).description) for name in preset_names()],
    )


def boundary_doses() -> str:
    """The axis of the doses of every kind of stress."""
    rows = [
        (f"`{kind}`", f"`{axis.field}`", f"{axis.weakest:g}", f"{axis.strongest:g}")
        for kind, axis in AXES.items()
    ]
    return _table(("kind", "dose", "weakest", "strongest"), rows)


def experiment_fields() -> str:
    """The fields of an experiment's file."""
    parts = {"": ExperimentSpec, "A base": Base, "A degradation": Degradation}
    return "\n".join(f"{title}\n\n{_fields(model, ())}" for title, model in parts.items())


def system_fields() -> str:
    """The fields of the description of a program."""
    parts = {"": CommandSpec, "`limits`": Limits, "`environment`": Environment}
    return "\n".join(f"{title}\n\n{_fields(model, ())}" for title, model in parts.items())


def batch_fields() -> str:
    """The fields of a batch's file."""
    return _fields(BatchSpec, ())


def batch_columns() -> str:
    """The columns of a batch's row."""
    return _table(("column", "meaning"), [(f"`{name}`", words) for name, (_, words) in BATCH_COLUMNS.items()])


def record_columns() -> str:
    """The columns of a unit's record."""
    tables = {
        "": UNIT_COLUMNS,
        "Per arm and recovery thread, as in `free_r1_failed` or `cross_r2_cpu_ms`:": THREAD_COLUMNS,
        "With J the first 1, 2, … threads, as in `d1` or `m2`:": {
            k: ("bool", v) for k, v in FAILURES.items()
        },
        "Per gap between two frames of the lead-in, as in `pairs27_rotation_deg`:": PAIR_COLUMNS,
    }
    return "\n".join(
        f"{title}\n\n{_table(('column', 'type', 'meaning'), _column_rows(of))}"
        for title, of in tables.items()
    )


def _column_rows(of: Mapping[str, tuple[str, str]]) -> list[tuple[str, ...]]:
    return [(f"`{name}`", domain, meaning) for name, (domain, meaning) in of.items()]


def settings() -> str:
    """Every setting of the SLAM; comments are wrapped."""
    lines = []
    for line in settings_yaml().splitlines():
        indent, hash_, comment = line.partition("# ")
        if hash_:
            lines += textwrap.wrap(comment, 80, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")
        else:
            lines.append(line)
    return "```yaml\n" + "\n".join(lines) + "\n```"


def commands() -> str:
    """The reference of the command line."""
    typer = [
        sys.executable,
        "-m",
        "typer",
        "dslab.experiments.cli.commands",
        "utils",
        "docs",
        "--name",
        "dslab",
    ]
    text = subprocess.run(typer, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    # Lists of commands cut short, whose sections follow; what every command has.
    text = re.sub(r"\*\*Commands\*\*:\n\n(\* .*\n)+", "", text)
    text = re.sub(r"(\*\*Options\*\*:\n\n)?\* `--help`: .*\n", "", text)
    return text.partition("\n")[2]


def _about(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split())


def _fields(model: type[BaseModel], without: tuple[str, ...] = ("kind",)) -> str:
    """A table of a model's fields; the unit is read off a name's ending."""
    schema = model.model_json_schema()
    rows = []
    for name, field in schema["properties"].items():
        if name not in without:
            default = "required" if name in schema.get("required", ()) else _value(field.get("default"))
            span = f"{_range(field)} {label_and_unit(name)[1].strip()}"
            rows.append((f"`{name}`", default, span, field.get("description", "")))
    return _table(("key", "default", "range and unit", "meaning"), rows)


def _value(default: object) -> str:
    """A default as written in YAML; nothing for one that is made by the model or left out."""
    if isinstance(default, bool):
        return f"`{default}`".lower()
    return f"`{default}`" if isinstance(default, str | int | float) else ""


def _range(field: Mapping) -> str:
    options = field.get("enum") or next((o["enum"] for o in field.get("anyOf", ()) if "enum" in o), None)
    if options:
        return ", ".join(f"`{option}`" for option in options)
    bounds = next(
        (o for o in (field, *field.get("anyOf", ())) if {"minimum", "exclusiveMinimum"} & set(o)), {}
    )
    low = (
        f"above {bounds['exclusiveMinimum']:g}"
        if "exclusiveMinimum" in bounds
        else f"{bounds.get('minimum', '')}"
    )
    high = (
        f"below {bounds['exclusiveMaximum']:g}"
        if "exclusiveMaximum" in bounds
        else f"{bounds.get('maximum', '')}"
    )
    if low and high:
        return f"{low} to {high}"
    return low if "above" in low else f"from {low}" if low else high


def _table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """A Markdown table; columns in which nothing stands are left out."""
    rows = [tuple(" ".join(str(cell).split()).replace("|", "\\|") for cell in row) for row in rows]
    kept = [k for k in range(len(header)) if any(row[k] for row in rows)]
    lines = [[header[k] for k in kept], ["---"] * len(kept), *([row[k] for k in kept] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
