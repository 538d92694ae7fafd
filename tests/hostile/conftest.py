"""Numbers of hostile inputs and signals, and the counts of what became of them.

``HOSTILE_INPUTS`` and ``HOSTILE_SIGNALS`` set the numbers, ``HOSTILE_SEED`` other inputs than the usual ones.
"""

import os
from collections import Counter
from zlib import crc32

import pytest
from hypothesis import HealthCheck, Phase, seed, settings

_USUAL = {"HOSTILE_INPUTS": 50, "HOSTILE_SIGNALS": 8}
_COUNTS: Counter[tuple[str, str, str]] = Counter()


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    from hostile_lab import Lab

    lab = Lab(tmp_path_factory.mktemp("hostile"))
    yield lab
    lab.close()


@pytest.fixture
def findings():
    """Collects the cases of one test; their counts are printed at the end of the session."""
    from hostile_oracle import Findings

    found = Findings()
    yield found
    _COUNTS.update(found.counts)


@pytest.fixture(scope="session")
def hostile_seed() -> int:
    return int(os.environ.get("HOSTILE_SEED", "0"))


@pytest.fixture(scope="session")
def cases():
    """The number of cases of a test: a share of the inputs or signals."""
    return lambda of, share: max(1, round(int(os.environ.get(of, _USUAL[of])) * share))


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
