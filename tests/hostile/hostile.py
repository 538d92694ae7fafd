"""Hostile inputs and signals in numbers, test by test: what an earlier call has done is not done again.

    .venv/bin/python tests/hostile/hostile.py --inputs 2000 --signals 200 --seed 1 --report hostile.jsonl

Prints every fault with its first case, and a line of all; the exit code is 1 if there is a fault.
"""

import argparse
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

FOLDER = Path(__file__).parent


def main() -> int:
    """Do what the report lacks, and say what is in it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--signals", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="other inputs than the usual ones")
    parser.add_argument("--only", default="", help="tests by words, as pytest's -k")
    parser.add_argument("--report", type=Path, default=Path("hostile.jsonl"), help="a line per test")
    given = parser.parse_args()
    run = {"inputs": given.inputs, "signals": given.signals, "seed": given.seed}
    environment = {f"HOSTILE_{name.upper()}": str(number) for name, number in run.items()}
    environment |= {"HOSTILE_REPORT": str(given.report.absolute())}
    words = [
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--tb=no",
        "-r",
        "",
        "-k",
        given.only,
        str(FOLDER),
    ]
    code = subprocess.run([sys.executable, *words], env=os.environ | environment, check=False).returncode
    done = [line for line in lines(given.report) if line["run"] == run]
    for line in done:
        for fault, cases in line["faults"].items():
            print(f"[{len(cases)}x] {fault}\n    {cases[0]}")
    outcomes = Counter()
    for line in done:
        outcomes.update(line["outcomes"])
    said = ", ".join(f"{number} {outcome}" for outcome, number in sorted(outcomes.items()))
    print(f"hostile, seed {given.seed}, {len(done)} tests, {outcomes.total()} cases: {said}")
    return int(bool(outcomes["faulty"]) or code not in (0, 1, 5))


def lines(report: Path) -> list[dict]:
    """The tests of a report; a line that was cut off is none."""
    if not report.exists():
        return []
    return [json.loads(line) for line in report.read_text().splitlines() if line.endswith("}")]


if __name__ == "__main__":
    sys.exit(main())
