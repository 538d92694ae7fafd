"""Commands on mutated inputs, and the judgement of what they did."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hostile_examples import EXAMPLES, Example
from hostile_mutations import Mutation
from hostile_oracle import Ended, at_work, contents, debris, differing, faults_of, filled, passing, text

SECONDS = 30
RENDERS = "export {in}/scenario"
"""How commands that open a context of OpenGL begin."""
_MEASURED = {"summary.json", "frames.csv", "report.html"}


@dataclass(frozen=True)
class Case:
    """The end of a command on one input, all that is wrong with it, what it read, and what it noticed."""

    ended: Ended
    outcome: str
    faults: list[str]
    seen: dict[str, str]
    notes: set[str]


class Lab:
    """Runs commands in folders of their own."""

    def __init__(self, root: Path) -> None:
        self._root, self._number = root, 0
        self._valid: dict[tuple[Example, str], Case] = {}
        environment = {
            **os.environ, "OMP_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8:strict", "HOME": str(root),
            "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
        }  # fmt: skip
        self._server = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("fork_server.py"))], env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._load(*(EXAMPLES[name] for name in ("tum", "scenario", "folder of an experiment")))

    def close(self) -> None:
        self._server.stdin.close()
        self._server.wait()

    def folder(self, example: Example) -> Path:
        """An example as it should be, under the same name as its mutants."""
        folder = self._root / "valid" / example.name / "given"
        if not folder.exists():
            if example.heavy:
                self._load(example)
            folder.parent.mkdir(parents=True)
            example.write(folder)
        return folder

    def valid(self, example: Example, command: str) -> Case:
        """The end of a command on an example as it should be."""
        if (example, command) not in self._valid:
            case = self.run(example, command)
            if case.ended.code != 0 and not command.startswith("experiment replay"):
                raise AssertionError(f"{command}: {case.ended.code}: {case.ended.err}")
            self._valid[example, command] = case
        return self._valid[example, command]

    def judge(self, example: Example, command: str, mutation: Mutation) -> tuple[str, list[str]]:
        """The outcome of a command on a mutated example, and its faults."""
        command = command.replace("{changed}", f"{{in}}/{mutation.path}")
        valid = self.valid(example, command)
        case = self.run(example, command, mutation)
        # What is noticed is no silent change.
        is_silent = case.ended.code == 0 and case.notes <= valid.notes
        if is_silent and mutation.strict and case.seen != valid.seen:
            changed = differing(case.seen, valid.seen)
            return case.outcome, [*case.faults, "silently changed: " + ", ".join(changed)]
        return case.outcome, case.faults

    def run(
        self,
        example: Example,
        command: str,
        mutation: Mutation | None = None,
        given: str = "given",
        result: str = "result",
        more: Sequence[str] = (),
        stdout: str | None = None,
        limits: Sequence[tuple[str, int]] = (),
        **environment: str,
    ) -> Case:
        """Run a command on a copy of an example.

        Args:
            example: the input.
            command: with the places of input and output.
            mutation: of one file of the copy.
            given: name of the copy.
            result: name of the output.
            more: further words, as they are but for the places.
            stdout: a file to write to instead.
            limits: of the process, by their names after ``RLIMIT_``.
            environment: variables.
        """
        folder = self._root / f"case-{self._number:06d}"
        self._number += 1
        for name in ("out", "tmp"):
            (folder / name).mkdir(parents=True)
        shutil.copytree(self.folder(example), folder / given)
        if mutation is not None:
            mutation.apply(folder / given / mutation.path)
        before = contents(folder / given)
        places = {"{in}": str(folder / given), "{out}": str(folder / "out" / result)}
        variables = {"TMPDIR": str(folder / "tmp"), "DSLAB_CACHE_DIR": str(folder / "cache")}
        variables |= {
            name: filled(value, places) for name, value in (example.environment | environment).items()
        }
        words = [filled(word, places) for word in (*command.split(), *more)]
        ended = self._call(words, folder, variables, stdout or str(folder / "stdout"), limits)
        after = contents(folder / given)
        changed = [n for n in {*before, *after} if before.get(n) != after.get(n) and not passing(n, example)]
        faults = faults_of(ended, command)
        may_be = result if ended.code == 0 or (example.kept and ended.code == 2) else None
        faults += debris(folder, given, may_be, ended.code)
        outcome = {0: "accepted", 2: "refused"}.get(ended.code, "failed")
        if ended.code != 0:
            faults += [f"input {'changed' if name in before else 'added'}: {name}" for name in changed]
        if at_work(command, ended):
            outcome, faults = "at work", []
        seen = {f"given/{name}": after.get(name, "") for name in changed}
        seen |= _seen(folder, result, command, ended)
        shutil.rmtree(folder, ignore_errors=True)
        seen = {name: digest for name, digest in seen.items() if Path(name).name not in _MEASURED}
        lines = ended.err.replace(str(folder), "").splitlines()
        return Case(ended, outcome, faults, seen, {line for line in lines if line.startswith("note: ")})

    def _call(
        self, words: list[str], folder: Path, variables: dict[str, str], stdout: str, limits: Sequence
    ) -> Ended:
        stderr = folder / "stderr"
        files = {"stdout": stdout, "stderr": str(stderr), "cwd": str(folder)}
        answer = self._ask(argv=words, env=variables, seconds=SECONDS, limits=limits, **files)
        out = text(Path(stdout)) if Path(stdout).is_file() else ""
        return Ended(answer.pop("code"), out, text(stderr), **answer)

    def _load(self, *examples: Example) -> None:
        """Let the server import and compile what every child would import and load again."""
        for example in examples:
            folder = self._root / "first" / example.name
            example.write(folder)
            for number, command in enumerate(example.commands):
                # Neither a context of OpenGL nor another process outlives a fork.
                if not command.startswith((RENDERS, "experiment replay", "batch")):
                    places = {"{in}": str(folder), "{out}": f"{folder}-{number}"}
                    self._ask(argv=[filled(word, places) for word in command.split()], here=True)

    def _ask(self, **job) -> dict:
        self._server.stdin.write(json.dumps(job) + "\n")
        self._server.stdin.flush()
        return json.loads(self._server.stdout.readline())


def _seen(folder: Path, result: str, command: str, ended: Ended) -> dict[str, str]:
    """What a command says that it has read: its output, without measurements."""
    seen = {f"out/{name}": digest for name, digest in contents(folder / "out").items()}
    if not command.startswith(("run", RENDERS, "experiment r", "view", "bench")):
        seen["stdout"] = ended.out.replace(str(folder), "")
    summary = folder / "out" / result / "summary.json"
    if summary.exists():
        seen["settings"] = json.dumps(json.loads(summary.read_text()).get("config"))
    return seen
