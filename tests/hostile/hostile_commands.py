"""Every command with valid arguments that end soon, and hostile words for its options."""

from collections.abc import Iterator
from typing import Any

import typer

from dslab.experiments.cli.commands import app

ARGUMENTS = {
    "demo": "--out {in}/result",
    "degrade": "{in}/tum --segment jpeg:start_s=0.1,duration_s=0.2,quality=8 --out {out}",
    "export": "{in}/tum --format tum --out {out}",
    "run": "{in}/tum --out {out}",
    "batch": "{in}/nothing.yaml --out {in}/result",
    "systems check": "base --source {in}/nothing",
    "systems install": "dual",
    "view": "{in}/result",
    "picture": "{in}/result --out {out}.png",
    "paper": "--out {in}/result",
    "scenarios show": "{in}/scenario/scenario.yaml",
    "scenarios validate": "{in}/scenario/scenario.yaml",
    "scenarios gallery": "{in}/scenario/scenario.yaml --out {in}/result",
    "experiment run": "{in}/experiment/spec.yaml --out {in}/experiment/experiment",
    "experiment status": "{in}/experiment/experiment",
    "experiment export": "{in}/experiment/experiment",
    "experiment report": "{in}/experiment/nothing",
    "experiment replay": "{in}/experiment/experiment none",
    "experiment power": "--p0 0.25 --pr 0.2 --worlds 10",
    "experiment prove": "--only nothing",
    "experiment fuzz": "--out {in}/result",
    "bench slam": "{in}/nothing",
    "bench sim": "--renderer nothing",
    "bench experiment": "{in}/nothing.yaml",
    "vocabulary train": "--out {in}/nothing.txt",
}
"""Commands without arguments, and those that come to be, need no entry."""
WORDS = (
    "", " ", "abc", "-1", "0", "1", "2.5", "-0.5", "nan", "inf", "-inf", "1e308", "1e400", "1_0", "0x10",
    "\u0661", "99999999999999999999", "9" * 401, "true", "null", ".", "..", "/", "/dev/null", "/dev/zero",
    "/dev/full", "/dev/full/x", "/proc/self/mem", "/proc/x/y", "{in}", "{in}/tum/rgb.txt", "{in}/tum",
    "{in}/scenario/scenario.yaml", "{in}/nothing/deep/er", "{out}/a/b/c", "{out}.npz", "x" * 300, "y/" * 2100,
    "[red]x[/red]", "[/]", "a\nb", "a\x1b[31mb", "\udcff", "\u202ex", "\U0001f642", "--", "-", "%s%n", "{0}",
    "a,b,,c", "orb,orb", "orb,sift,gms,x", "base,,dual", "tum", "=", "tcp://127.0.0.1:1", "sh -c 'exit 3'",
    "'", "kitti-like/99", "stressed/../x", "jpeg:", "fog:start_s=1", ":" * 50,
)  # fmt: skip


def commands() -> dict[str, Any]:
    """Every command of the lab by its words."""
    return dict(_leaves(typer.main.get_command(app), ()))


def options_of(command: Any) -> list[str]:
    """Every spelling of the options of a command."""
    return [
        name for p in command.params if p.param_type_name == "option" for name in (*p.opts, *p.secondary_opts)
    ]


def _leaves(command: Any, path: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    for name, inner in getattr(command, "commands", {}).items():
        yield from _leaves(inner, (*path, name))
    if not hasattr(command, "commands"):
        yield " ".join(path), command
