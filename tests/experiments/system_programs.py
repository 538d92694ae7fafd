"""Programs as systems for tests: one that copies the truth, and what programs do wrong."""

import sys
from pathlib import Path

import numpy as np

from dslab.experiments.runs.systems.command import CommandSystem
from dslab.experiments.runs.systems.command_spec import read_command_spec

# Copies the poses beside it for the stamps of rgb.txt, at half the scale; EDIT is done before it writes.
COPY = """
import json, pathlib, sys, time
seq, out = map(pathlib.Path, sys.argv[1:3])
listed = (seq / "rgb.txt").read_text().splitlines() if (seq / "rgb.txt").exists() else []
stamps = [line.split()[0] for line in listed if line[0] != "#"]
poses = [line.split() for line in pathlib.Path(__file__).with_name("poses.txt").read_text().splitlines()]
rows = [[s, *(str(0.5 * float(x)) for x in p[1:4]), *p[4:]] for s, p in zip(stamps, poses)]
name = "trajectory.txt"
EDIT
(out / name).write_text("".join(" ".join(row) + "\\n" for row in rows))
"""


def write_program(folder: Path, sequence, edit: str = "pass", **fields: object) -> Path:
    """Write a program with its poses and its description; returns the description."""
    from scipy.spatial.transform import Rotation

    quat = Rotation.from_matrix(sequence.T_world_cam[:, :3, :3]).as_quat()
    table = np.column_stack([sequence.stamps_s, sequence.T_world_cam[:, :3, 3], quat])
    folder.mkdir(exist_ok=True, parents=True)
    np.savetxt(folder / "poses.txt", table)
    (folder / "program.py").write_text(COPY.replace("EDIT", edit))
    lines = {"command": f"'{sys.executable} {{here}}/program.py {{sequence}} {{out}}'", **fields}
    path = folder / "copy.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return path


def program(folder: Path, sequence, edit: str = "pass", **fields: object) -> CommandSystem:
    """The system of such a program."""
    path = write_program(folder, sequence, edit, **fields)
    return CommandSystem("copy", read_command_spec(path), path)
