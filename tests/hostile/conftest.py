"""Numbers of hostile inputs and signals, and the counts of what became of them.

``HOSTILE_INPUTS`` and ``HOSTILE_SIGNALS`` set the numbers, ``HOSTILE_SEED`` other inputs than the usual ones.
``HOSTILE_REPORT`` names a file that is given a line per test; tests that it has are not done again.
"""

import json
import os
from collections import Counter
from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import HealthCheck, Phase, seed, settings

_USUAL = {"HOSTILE_INPUTS": 50, "HOSTILE_SIGNALS": 8, "HOSTILE_SEED": 0}
_COUNTS: Counter[tuple[str, str, str]] = Counter()


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    from hostile_lab import Lab

    lab = Lab(tmp_path_factory.mktemp("hostile"))
    yield lab
    lab.close()


def _number(name: str) -> int:
    return int(os.environ.get(name, _USUAL[name]))


def _run() -> dict[str, int]:
    return {name.removeprefix("HOSTILE_").lower(): _number(name) for name in _USUAL}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    if not (report := os.environ.get("HOSTILE_REPORT")):
        return
    from hostile import lines

    done = {line["test"] for line in lines(Path(report)) if line["run"] == _run()}
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid in done])
    items[:] = [item for item in items if item.nodeid not in done]


@pytest.fixture
def findings(request):
    """Collects the cases of one test; their counts are printed at the end of the session."""
    from hostile_oracle import Findings

    found = Findings()
    yield found
    _COUNTS.update(found.counts)
    if report := os.environ.get("HOSTILE_REPORT"):
        outcomes = Counter()
        for (_, _, outcome), number in found.counts.items():
            outcomes[outcome] += number
        line = {"test": request.node.nodeid, "run": _run(), "outcomes": outcomes, "faults": found.faults}
        with Path(report).open("a") as file:
            file.write(json.dumps(line) + "\n")


@pytest.fixture(scope="session")
def hostile_seed() -> int:
    return _number("HOSTILE_SEED")


@pytest.fixture(scope="session")
def cases():
    """The number of cases of a test: a share of the inputs or signals."""
    return lambda of, share: max(1, round(_number(of) * share))


@pytest.fixture
def hostile(request, cases, hostile_seed):
    """Gives a property its share of the inputs: the same ones in every run with the same seed."""

    def configured(share: float):
        chosen = settings(
            max_examples=cases("HOSTILE_INPUTS", share), database=None, deadline=None,
            phases=[Phase.generate], suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        return lambda test: chosen(seed(crc32(request.node.name.encode()) + hostile_seed)(test))

    return configured


def pytest_terminal_summary(terminalreporter):
    if not _COUNTS:
        return
    terminalreporter.section("hostile inputs")
    for about in sorted({about for about, _, _ in _COUNTS}):
        terminalreporter.write_line(f"{about}: {_told(lambda key, about=about: key[0] == about)}")
    terminalreporter.write_line(f"in all: {_told(lambda key: True)}")


def _told(chosen) -> str:
    outcomes = Counter()
    for key, number in _COUNTS.items():
        if chosen(key):
            outcomes[key[2]] += number
    return f"{outcomes.total()}: " + ", ".join(f"{n} {outcome}" for outcome, n in sorted(outcomes.items()))
