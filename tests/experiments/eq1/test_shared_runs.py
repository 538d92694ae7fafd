"""What units share makes them faster and changes nothing in their records."""

import pytest
from unit_scenes import END, FRAMES, ONSET, run, synthetic, unit

from dslab.experiments.eq1 import shared_runs
from dslab.experiments.eq1.records import decided
from dslab.slam import factory


@pytest.fixture
def fed(monkeypatch):
    """The frames that systems of the lab were given, one by one."""
    monkeypatch.setattr(shared_runs, "_lead_ins", {})
    monkeypatch.setattr(shared_runs, "_runs", {})
    given, process = [], factory.MonocularSlam.process
    monkeypatch.setattr(
        factory.MonocularSlam, "process", lambda self, *a: given.append(self.frames) or process(self, *a)
    )
    return given


def forget():
    shared_runs._lead_ins.clear()
    shared_runs._runs.clear()


@pytest.mark.parametrize("blank", [(), (range(ONSET + 5, END),)])
def test_dual_slam_goes_on_from_the_system_that_it_is_made_over(monkeypatch, fed, blank):
    sequence, systems = synthetic(*blank), ("base", "dual(base)")
    records, frames = [], []
    for is_kept in (True, False):
        for system in systems:
            fed.clear()
            of = unit("orb", system=system, arms=("free",), settings={"framework": {"start_poses": 20}})
            records.append(decided(run(monkeypatch, sequence, of)))
            frames.append(len(fed))
            if not is_kept:
                forget()
        forget()
    assert records[:2] == records[2:] and records[0]["breakage"] == bool(blank)
    assert frames[0] == frames[2] == FRAMES
    assert frames[3] - frames[1] >= (ONSET if blank else FRAMES)


def test_cells_share_the_lead_in_and_only_that(monkeypatch, fed):
    of = unit("orb", system="base", arms=("free",))
    alone = decided(run(monkeypatch, synthetic(range(ONSET + 5, END)), of))
    forget()
    run(monkeypatch, synthetic(), of)
    fed.clear()
    assert decided(run(monkeypatch, synthetic(range(ONSET + 5, END)), of)) == alone
    assert fed == list(range(ONSET, FRAMES))
