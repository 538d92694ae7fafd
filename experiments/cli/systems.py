"""``dslab systems``."""

from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.console import SystemsOption, out, print_facts, print_rows, progress_bars, say
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.experiments.runs.systems.registry import Registry

NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Name of a system, or module:Class.")]
app = typer.Typer(
    no_args_is_help=True,
    help="SLAM systems to run: ours, classes of your own, programs of other people. See them, check them, "
    "install them.",
)
_LOG_CHARACTERS = 2000
_OURS = {
    "base": "ORB-SLAM's method",
    "dual": "Dual-SLAM",
    "dual+": "Dual-SLAM with initialization by GMS",
    "orbslam": "ORB-SLAM as published in 2015",
    "paper": "Dual-SLAM by the paper's text, on orbslam",
    "paper+": "that with initialization by GMS",
    "dso": "direct sparse odometry",
    "ldso": "that with loops",
}


@app.command("list")
def list_command(systems_dir: SystemsOption = None) -> None:
    """List every system: what it is, which parts of Dual-SLAM's protocol it has, and whether it can be run.

    Beside ours: programs that a YAML file describes, in the lab or in the folders of `--systems` and
    `DSLAB_SYSTEMS`, and classes that installed packages bring (entry points `dslab.systems`). For example:

    `dslab systems list`
    """
    from dslab.experiments.runs.systems.registry import Registry

    registry = Registry.open(systems_dir or ())
    print_rows({"system": name, **_described(registry, name)} for name in registry.names())


@app.command("check")
def check_command(
    name: NameArgument,
    source: Annotated[str, typer.Option(help="A sequence folder or scenario.")] = "small/corridor",
    systems_dir: SystemsOption = None,
) -> None:
    """Run a system over a short sequence and say whether what it gives can be used.

    Ends with exit code 2 and one line if it cannot be started, does not end well, or leaves other files than
    its description says. For example:

    `dslab systems check my_slam:MySlam --source path/to/sequence`
    """
    from dslab.experiments.evaluation.summary import is_tracked
    from dslab.experiments.runs.ending import EndKind
    from dslab.experiments.runs.sources import open_sequence
    from dslab.experiments.runs.systems.command import LOG_FILE
    from dslab.experiments.runs.systems.registry import Registry
    from dslab.experiments.runs.systems.run import run_system
    from dslab.sim.unfinished import scratch_folder

    system = Registry.open(systems_dir or ()).find(name)
    with progress_bars() as show, scratch_folder() as scratch:
        record = run_system(system, open_sequence(source, progress=show), 0, folder=scratch)
        log = scratch / LOG_FILE
        printed = log.read_text(errors="replace")[-_LOG_CHARACTERS:] if log.exists() else ""
    ending = record.ending
    if ending.kind is not EndKind.FINISHED:
        out.print(printed, end="" if printed.endswith("\n") or not printed else "\n")
        remedy = ending.remedy or "see what it prints"
        raise InputError(f"system {system.name}", f"{ending.kind}: {ending.message}", remedy)
    print_facts(
        {
            "system": system.name,
            "ended": ending.kind.value,
            "frames": len(record.results),
            "with a live pose": sum(map(is_tracked, record.results)),
            "with a final pose": len(record.trajectories[0].frames) if record.trajectories else 0,
            "declares": record.declares.value,
        }
    )


@app.command("install")
def install_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of a system, such as orbslam3.")],
    repository: Annotated[
        str | None,
        typer.Option(
            metavar="PATH|URL",
            help="Repository of this lab, for a release or commit of it; the checkout that dslab runs from.",
            show_default=False,
        ),
    ] = None,
    systems_dir: SystemsOption = None,
) -> None:
    """Install a system into an environment of its own, in the user's cache folder.

    Its packages come from PyPI, by uv if there is one, else by pip. They stay apart from the lab's, and under
    their own licences. A release of this lab, or any commit, is made from its repository and its kernels are
    compiled, which takes minutes; then `base@0.2.0`, `dual@0.2.0` and so on are systems. For example:

    `dslab systems install lab@0.2.0`
    """
    from dslab.experiments.runs.systems.command import CommandSystem
    from dslab.experiments.runs.systems.environments import install
    from dslab.experiments.runs.systems.registry import Registry

    system = Registry.open(systems_dir or ()).find(name)
    environment = system.spec.environment if isinstance(system, CommandSystem) else None
    if environment is None:
        raise InputError(f"system {name}", "has no environment to install", "see `dslab systems list`")
    say(f"installing {' '.join(environment.contents)}")
    with progress_bars(kernels=False) as show:
        show("installing", 0, 1)
        place = install(name, environment, repository)
    say(f"{name}: {place}")


def _described(registry: "Registry", name: str) -> dict[str, str]:
    from dslab.experiments.runs.systems.command import CommandSystem
    from dslab.experiments.runs.systems.framework import parts
    from dslab.experiments.runs.systems.own_class import ClassSystem
    from dslab.experiments.runs.systems.registry import OwnSystem

    try:
        system = registry.find(name)
    except InputError as fault:
        return {"what": "-", "parts": "-", "state": str(fault)}
    has = parts(system).words
    if isinstance(system, OwnSystem):
        return {"what": _OURS[name], "parts": has, "state": "ready"}
    if isinstance(system, ClassSystem):
        return {"what": f"class {system.source}", "parts": has, "state": "ready"}
    assert isinstance(system, CommandSystem)
    try:
        system.check()
    except InputError as fault:
        state = f"{fault.problem}; {fault.remedy}"
    else:
        pace = "in real time" if system.takes_real_time else "as fast as it can"
        state = f"ready, takes frames {pace}"
    return {"what": system.spec.about or str(system.file), "parts": has, "state": state}
