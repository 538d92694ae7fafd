"""What the documentation takes from the code: fields, kinds, commands, settings.

A function without an underscore is the NAME of ``<!-- made: NAME -->`` in a page.
"""

import re
import textwrap
from collections.abc import Mapping

import typer
from figures import bullets, table
from pydantic import BaseModel
from typer.cli import get_docs_for_click

from dslab.experiments.batch.rows import COLUMNS as BATCH_COLUMNS
from dslab.experiments.batch.spec import BatchSpec
from dslab.experiments.claims.loading import claim_presets, load_claim
from dslab.experiments.cli.commands import app
from dslab.experiments.eq1.doses import AXES
from dslab.experiments.eq1.records import FAILURES, PAIR_COLUMNS, THREAD_COLUMNS, UNIT_COLUMNS
from dslab.experiments.eq1.spec import ExperimentSpec, load_spec, preset_names
from dslab.experiments.eq1.spec_parts import Base, Degradation
from dslab.experiments.runs.slam_settings import settings_yaml
from dslab.experiments.runs.systems.command_spec import CommandSpec, Environment, Limits
from dslab.scenarios.cameras import PRESETS as CAMERAS
from dslab.scenarios.cameras import Camera
from dslab.scenarios.describe import describe_kind
from dslab.scenarios.describe_fields import described_fields
from dslab.scenarios.families import library_names, load_family
from dslab.scenarios.imu import Imu
from dslab.scenarios.motions import KINDS as MOTIONS
from dslab.scenarios.motions import Trajectory
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.scenarios.worlds import WORLD_KINDS, Aliasing
from dslab.sim.degradations.recorded_kinds import recorded_sequence_kinds
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.slam import orbslam
from dslab.slam.dual import paper

WIDTH = 116


def what_stays_different() -> str:
    """What the systems by the published texts have that these do not say."""
    base = [f"`{name}`: {what}" for name, what in orbslam.STAYS.items()]
    dual = [f"`{name}`: {what}" for name, what in paper.STAYS.items()]
    count = len(orbslam.PUBLISHED)
    return "\n".join(
        [
            f"**Of `orbslam`** ({count} settings are published):\n",
            *bullets([*base, *orbslam.STAYS_IN_CODE]),
            "\n**Of `paper` and `paper+`, beside that:**\n",
            *bullets([*dual, *paper.STAYS_IN_CODE]),
        ]
    )


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
    picture = ".svg" if DEGRADATIONS[kind].stage.name == "TIMING" else ".jpg"
    return f"""## {name.capitalize().replace("Jpeg", "JPEG")}

{_wrapped(_about(model))}

<!-- site: ![{name}: without, with](stress/{kind}{picture}) -->

{_wrapped(f"**`{kind}`** · {where}{ramp} Measured on every frame as `{measure}`.")}

{_fields(model, ("kind", "start_s", "duration_s", "ramp_s", "fall_s"))}
"""


def worlds() -> str:
    """A section per kind of world."""
    return "\n".join(
        f"### {describe_kind(kind).capitalize()}\n\n"
        + f"{_wrapped(f'`kind: {kind}`: {_about(model)}')}\n\n{_fields(model)}"
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
    return _fields(Trajectory) + "\n" + table(("kind", "sets"), rows)


def cameras() -> str:
    """The fields of a camera, and its presets."""
    columns = ("width_px", "height_px", "fx_px", "fps")
    rows = []
    for name, preset in CAMERAS.items():
        lens = preset.get("distortion", {}).get("model", "")
        rows.append((f"`{name}`", *(f"{preset[column]:g}" for column in columns), lens))
    return _fields(Camera) + "\n" + table(("preset", *columns, "distortion"), rows)


def imu() -> str:
    """The fields of an inertial sensor."""
    return _fields(Imu, ())


def library() -> str:
    """Every family of scenarios that comes with dslab."""
    return "\n".join(map(_family, library_names()))


def _family(name: str) -> str:
    family = load_family(name)
    members = _members(list(family.members))
    return _item(f"**`{name}`**{f' ({members})' if members else ''}. {family.description}")


def _members(names: list[str]) -> str:
    numbered = names and all(name.isdigit() for name in names)
    named = f"{names[0]} to {names[-1]}" if numbered else ", ".join(names)
    return f"{len(names)}: {named}" if names else ""


def presets() -> str:
    """Every experiment that comes with dslab."""
    of_eq1 = {name: load_spec(name).description for name in preset_names()}
    claimed = {name: load_claim(name) for name in claim_presets()}
    on_claims = {name: f"Sec. {spec.section}. {spec.description}" for name, spec in claimed.items()}
    return "\n".join(_item(f"**`{name}`**: {told}") for name, told in (of_eq1 | on_claims).items()) + "\n"


def boundary_doses() -> str:
    """The axis of the doses of every kind of stress."""
    rows = [
        (f"`{kind}`", f"`{axis.field}`", f"{axis.weakest:g}", f"{axis.strongest:g}")
        for kind, axis in AXES.items()
    ]
    return table(("kind", "dose", "weakest", "strongest"), rows)


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
    return table(("column", "meaning"), [(f"`{name}`", words) for name, (_, words) in BATCH_COLUMNS.items()])


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
        f"{title}\n\n{table(('column', 'type', 'meaning'), _column_rows(of))}" for title, of in tables.items()
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
    command = typer.main.get_command(app)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="dslab")
    # Lists of commands cut short, whose sections follow; what every command has.
    text = re.sub(r"\*\*Commands\*\*:\n\n(\* .*\n)+", "", text)
    text = re.sub(r"(\*\*Options\*\*:\n\n)?\* `--help`: .*\n", "", text).partition("\n")[2].strip()
    text = re.sub(r"\*\*Usage\*\*:\n\n```console\n\$ (.*)\n```", r"Usage: `\1`", text)
    text = text.replace(f"  [0<=x<={2**63 - 1}]", "")
    lines = (_wrapped(line, "  " if line.startswith("*") else "") for line in text.splitlines())
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)) + "\n"


def _about(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split())


def _fields(model: type[BaseModel], without: tuple[str, ...] = ("kind",)) -> str:
    """A list of a model's fields, each with default and range."""
    items = [
        _item(f"**`{name}`**{f' ({about})' if about else ''}{meaning and f': {meaning}'}")
        for name, about, meaning in described_fields(model, without)
    ]
    return "\n".join(items) + "\n"


def _item(text: str) -> str:
    return _wrapped(f"- {' '.join(text.split())}", "  ")


def _wrapped(text: str, indent: str = "") -> str:
    """Prose in lines of bounded length."""
    if len(text) <= WIDTH:
        return text
    return textwrap.fill(
        text, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
