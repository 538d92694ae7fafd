"""Peer programs that copy the truth, for tests."""

import shlex
import sys

# Logs its run, copies the truth from frame `first` on at half the scale with noise.
PEER = """
import json, pathlib, random, sys
option, log, seq, out = sys.argv[1], *map(pathlib.Path, sys.argv[2:])
with log.open("a") as file:
    file.write("peer\\n")
stamps, truth = ([line.split() for line in (seq / name).read_text().splitlines() if line[0] != "#"]
                 for name in ("rgb.txt", "groundtruth.txt"))
first = int(option.split("=")[1])
noise = random.Random(0)
table = [[float(x) for x in row] for row in truth[first:]]
for row in table:
    row[1:4] = [0.5 * x + noise.gauss(0, 0.02) for x in row[1:4]]
lines = [" ".join(f"{x:.6f}" for x in row) for row in table]
(out / "trajectory.txt").write_text("\\n".join(lines))
summary = dict(cpu_ms_median=16.0, tracked=len(table), frames=len(stamps), first_tracked_frame=first)
(out / "summary.json").write_text(json.dumps(summary))
"""


def command(tmp_path, script, *options):
    """Command line of a peer program with options."""
    path = tmp_path / "peer program.py"
    path.write_text(script)
    return shlex.join([sys.executable, str(path), *map(str, options)])
