"""Whenever a signal comes, a command ends as it says, and leaves a whole result or nothing."""

import shutil
import signal
import time

import pytest
from hostile_signals import COMMANDS, LONG, RESUMED, Place, faults_of, survivors

from dslab.scenarios.seeds import rng_for

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
_LATEST_MS = 5000


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_signal_leaves_a_whole_result_or_nothing(name, tmp_path, findings, cases, hostile_seed):
    rng = rng_for(hostile_seed, "signals", name)
    for case in range(cases("HOSTILE_SIGNALS", 1 / len(COMMANDS))):
        number, after_ms = int(rng.choice(_SIGNALS)), int(rng.integers(_LATEST_MS))
        place = Place(tmp_path / str(case))
        running = place.start(name)
        time.sleep(after_ms / 1000)
        code, err = running.end(number)
        faults = faults_of(code, err, number, place.done(name))
        faults += [f"still runs: {alive}" for alive in survivors(running.mark, 10.0)]
        if number == signal.SIGKILL or name in RESUMED:
            faults += _start_again(place, name)
        faults += place.debris()
        outcome = "finished" if code == 0 else "ended"
        told = f"{name}: {signal.Signals(number).name} after {after_ms} ms"
        findings.add(f"signals, {name}", signal.Signals(number).name, outcome, faults, told)
        shutil.rmtree(place.folder, ignore_errors=True)
    assert not findings.faults, findings.text()


def _start_again(place: Place, name: str) -> list[str]:
    """Start a command once more, which sweeps what a killed one left and goes on; what is wrong then."""
    running = place.start(name)
    number = 0
    if name in LONG:
        time.sleep(3)
        number = signal.SIGTERM
    code, err = running.end(number)
    survivors(running.mark, 5.0)
    done = place.done(name)
    if code == 2 and done and "already holds files" in err:
        return []  # the first had just finished
    faults = faults_of(code, err, number, done) + (place.lacking() if name == "batch" else [])
    return [f"started again: {fault}" for fault in faults]
