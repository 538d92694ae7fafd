"""What a change must leave as it was: digests of runs, frames and records, by the command line alone.

    python tests/same_bits.py AFTER.json --against BEFORE.json [--only NAME ...] [--dslab COMMAND]

A run's digest is that of its trajectories and of its events without times of computation. Real sequences are
looked for in ../shared/data. Digests hold on one kind of processor: make BEFORE on the same machine.
"""

import argparse
import hashlib
import json
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

SYSTEMS = ("base", "dual", "dual+", "ldso")
SOURCES = ("stressed", "breakage", "covered-lens", "loop/city", "kitti-like/04", "../shared/data/kitti07_160")
FRAMES = ("small/city", "stressed", "covered-lens", "tum-mono-like/07")
UNITS = (
    "corridor/low_texture/1:0",
    "corridor/motion_blur/1:1",
    "corridor/fast_rotation/1:0",
    "room/fog-creeping/1:2",
    "room/fast_rotation/1:0",
    "warehouse/low_texture/1:9",
    "warehouse/motion_blur/1:0",
    "warehouse/fog-creeping/1:3",
)
_ABOUT_THE_RUN = {"unit_id", "code", "commit", "system_digest"}
_ABOUT_THE_RUN |= {"render_s", "slam_s", "cpu_s", "wall_s", "peak_rss_mb"}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="beginnings of names, such as run/stressed")
    parser.add_argument("--dslab", default="dslab", help="command to call")
    given = parser.parse_args()
    command = shlex.split(given.dslab)
    found = json.loads(given.out.read_text()) if given.out.exists() else {}
    before = json.loads(given.against.read_text()) if given.against else {}
    for name in names():
        if name in found or (given.only and not name.startswith(tuple(given.only))):
            continue
        found[name] = digest_of(command, name)
        told = "" if name not in before else "same" if before[name] == found[name] else f"WAS {before[name]}"
        print(f"{name:44} {found[name]} {told}", flush=True)
        given.out.write_text(json.dumps(found, indent=1) + "\n")
    differing = [name for name in found if name in before and before[name] != found[name]]
    print(f"{len(found)} digests, {len(differing)} of {len(set(found) & set(before))} differ")
    return 1 if differing else 0


def names() -> list[str]:
    there = [source for source in SOURCES if not source.startswith("..") or Path(source).is_dir()]
    runs = [f"run/{source}/{system}" for source in there for system in SYSTEMS]
    return [*(f"frames/{name}" for name in FRAMES), *runs, *(f"eq1/{unit}" for unit in UNITS)]


def digest_of(command: list[str], name: str) -> str:
    kind, _, what = name.partition("/")
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "out"
        if kind == "frames":
            call(command, "export", what, "--format", "tum", "--out", out, "--no-cache")
            return digest(file.read_bytes() for file in sorted(out.rglob("*.png")))
        if kind == "run":
            source, _, system = what.rpartition("/")
            call(command, "run", source, "--system", system, "--out", out)
            files = sorted(file for file in out.rglob("*.txt") if file.name != "groundtruth.txt")
            return digest([*(file.read_bytes() for file in files), *events(out / "events.jsonl")])
        # Exit code 1 says that it differs from the published record, which another machine made.
        answer = json.loads(call(command, "experiment", "replay", "docs/eq1", what, "--json", ends=(0, 1)))
        record = {key: value for key, value in answer["record"].items() if not about_the_run(key)}
        return digest([json.dumps(record, sort_keys=True).encode()])


def about_the_run(column: str) -> bool:
    return column in _ABOUT_THE_RUN or column.endswith("_ms")


def events(file: Path) -> Iterable[bytes]:
    for line in file.read_text().splitlines():
        event = {key: value for key, value in json.loads(line).items() if not about_the_run(key)}
        yield json.dumps(event, sort_keys=True).encode()


def digest(parts: Iterable[bytes]) -> str:
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return total.hexdigest()[:16]


def call(command: list[str], *words: object, ends: tuple[int, ...] = (0,)) -> str:
    done = subprocess.run([*command, *map(str, words)], capture_output=True, text=True, check=False)
    if done.returncode not in ends:
        sys.exit(f"{' '.join(map(str, words))}: exit code {done.returncode}\n{done.stderr}{done.stdout}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
