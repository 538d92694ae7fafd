"""Real time: late frames are dropped and counted, and the run is judged on the frames that were fed."""

from dataclasses import replace

import numpy as np
import pytest
from slam_fakes import FakeSystem, make_sequence

from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs.execution import execute
from dslab.experiments.runs.pacing import RealTime
from dslab.scenarios.errors import InputNotice
from dslab.sim.sequence import SegmentTruth


class FakeClock:
    """A clock that the test advances."""

    def __init__(self):
        self.time_s = 1000.0

    def perf_counter(self):
        return self.time_s

    def sleep(self, seconds):
        self.time_s += seconds


class SlowSystem(FakeSystem):
    """Takes ``seconds_for(stamp_s)`` for each frame and returns its true pose."""

    def __init__(self, sequence, clock, seconds_for):
        super().__init__(sequence.T_world_cam, starts_at=0)
        self.sequence, self.clock, self.seconds_for, self.seen_s = sequence, clock, seconds_for, []

    def process(self, image, stamp_s):
        source = int(np.argmin(np.abs(self.sequence.stamps_s - stamp_s)))
        np.testing.assert_array_equal(image, self.sequence.frames[source])
        self.T_world_cam = np.insert(
            self.T_world_cam[: len(self.seen_s)], len(self.seen_s), self.sequence.T_world_cam[source], axis=0
        )
        self.seen_s.append(stamp_s)
        self.clock.time_s += self.seconds_for(stamp_s)
        return super().process(image, stamp_s)


def run(sequence, seconds_for):
    clock = FakeClock()
    system = SlowSystem(sequence, clock, seconds_for)
    record = execute(sequence, "base", 0, build=lambda *_: system, pace=RealTime(sequence, clock))
    return record, system, clock


def test_a_fast_system_is_fed_every_frame_in_time():
    sequence = make_sequence(90, segment=None)
    record, _, clock = run(sequence, lambda stamp_s: 0.02)
    assert record.dropped_frames == 0 and record.sequence is sequence
    assert clock.time_s - 1000 == pytest.approx(89 / 30 + 0.02)


def test_a_system_that_takes_three_intervals_is_fed_every_third_frame():
    sequence = make_sequence(90, segment=None)
    record, system, _ = run(sequence, lambda stamp_s: 2.99 / 30)
    # A frame may be up to one interval late, so that two are lost for each that is fed.
    steps = np.diff(np.round(np.array(system.seen_s) * 30))
    assert set(steps[2:]) == {3}
    assert record.dropped_frames == 90 - len(record.results)
    assert summarise(record)["dropped_frames"] == record.dropped_frames


def test_an_hour_without_frames_is_not_waited_for():
    sequence = make_sequence(90, segment=None)
    stamps_s = sequence.stamps_s + np.where(np.arange(90) > 40, 3600.0, 0.0)
    with pytest.warns(InputNotice, match="frame 41 comes 3600 s after the one before; 10 s are waited"):
        record, _, clock = run(replace(sequence, stamps_s=stamps_s), lambda stamp_s: 0.02)
    assert record.dropped_frames == 0 and clock.time_s - 1000 == pytest.approx(88 / 30 + 10 + 0.02)


def test_a_hitch_costs_only_the_frames_within_it():
    sequence = make_sequence(90, segment=None)
    record, system, _ = run(sequence, lambda stamp_s: 0.5 if abs(stamp_s - 1.0) < 1e-6 else 0.01)
    fed = np.round(np.array(system.seen_s) * 30).astype(int)
    # 0.5 s from frame 30 on: frame 44 is due 0.033 s before its end, within an interval.
    assert sorted(set(range(90)) - set(fed)) == list(range(31, 44))
    assert record.dropped_frames == 13


def queue_of_one(due_s, seconds):
    """Frames taken by a driver whose queue holds only the newest image."""
    now_s, taken = 0.0, [-1]
    while taken[-1] < len(due_s) - 1:
        now_s = max(now_s, due_s[taken[-1] + 1])
        taken.append(int(np.flatnonzero(due_s <= now_s)[-1]))
        now_s += seconds[taken[-1]]
    return taken[1:]


@pytest.mark.parametrize("seed", range(5))
def test_the_frames_fed_are_those_of_a_queue_of_one_image(seed):
    sequence = make_sequence(90, segment=None)
    # Eighths of an interval plus a little, so that no frame is due exactly with the next one.
    eighths = np.random.default_rng(seed).geometric(0.12, 90)
    seconds = (eighths / 8 + 1e-3) / 30
    record, system, _ = run(sequence, lambda stamp_s: seconds[round(stamp_s * 30)])
    fed = np.round(np.array(system.seen_s) * 30).astype(int).tolist()
    expected = queue_of_one(sequence.stamps_s - sequence.stamps_s[0], seconds)
    assert 0 < record.dropped_frames == 90 - len(fed)
    # The last frame, which no later one replaces, is dropped like any other.
    assert [k for k in expected if k < 89] == [k for k in fed if k < 89]


def test_the_run_is_judged_on_the_frames_that_were_fed():
    sequence = make_sequence(90, segment=(20, 50))
    record, system, _ = run(sequence, lambda stamp_s: 2.99 / 30)
    summary = summarise(record)
    assert summary["ate_m"] < 1e-9 and summary["frames"] == len(system.seen_s) < 40
    (segment,) = summary["segments"]
    inside = [s for s in system.seen_s if 20 / 30 - 1e-6 <= s <= 50 / 30 + 1e-6]
    assert segment["frames"] == segment["tracked"] == len(inside)
    np.testing.assert_allclose(record.sequence.stamps_s, system.seen_s)


# -- sequences of some of the frames -------------------------------------------------------------------------


def segment(first, last, runs=()):
    return SegmentTruth("fog", {}, 0.0, 1.0, first, last, runs=runs)


def test_a_subsequence_keeps_all_data_of_its_frames():
    sequence = replace(
        make_sequence(10, segment=None),
        depths=[np.full((2, 2), float(i)) for i in range(10)],
        frame_truth={"blur_px": np.arange(10.0)},
        image_names=tuple(f"rgb/{i}.png" for i in range(10)),
    )
    kept = np.array([0, 3, 7])
    some = sequence.only(kept)
    assert len(some) == len(some.frames) == len(some.depths) == 3
    np.testing.assert_array_equal(some.stamps_s, sequence.stamps_s[kept])
    np.testing.assert_array_equal(some.T_world_cam, sequence.T_world_cam[kept])
    np.testing.assert_array_equal(some.frames[2], sequence.frames[7])
    assert some.depths[1][0, 0] == 3.0
    assert some.frame_truth["blur_px"].tolist() == [0, 3, 7]
    assert some.image_names == ("rgb/0.png", "rgb/3.png", "rgb/7.png")
    bare = replace(sequence, T_world_cam=None, depths=None, image_names=(), frame_truth={}).only(kept)
    assert bare.T_world_cam is None and bare.depths is None and bare.image_names == ()


def test_segments_of_a_subsequence_act_on_the_same_frames():
    """The frames on which a segment acts are the kept ones among those on which it acted."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        acts = rng.random(30) < 0.6
        starts = np.flatnonzero(acts & ~np.r_[False, acts[:-1]])
        ends = np.flatnonzero(acts & ~np.r_[acts[1:], False])
        if not len(starts):
            continue
        runs = tuple(zip(starts.tolist(), ends.tolist(), strict=True))
        kept = np.flatnonzero(rng.random(30) < rng.uniform(0.05, 0.9))
        left = segment(runs[0][0], runs[-1][1], runs).among(kept)
        np.testing.assert_array_equal(left.mask(len(kept)), acts[kept])
        places = np.flatnonzero(acts[kept])
        if left.runs:
            assert (left.runs[0][0], left.runs[-1][1]) == (places[0], places[-1])
        for (_, end), (start, _) in zip(left.runs, left.runs[1:], strict=False):
            assert start > end + 1
    whole = segment(4, 8).among(np.array([1, 5, 6, 9]))
    assert (whole.first_frame, whole.last_frame, whole.runs) == (1, 2, ())
    assert segment(4, 8).among(np.array([1, 2, 9])).first_frame == -1
    assert segment(-1, -1).among(np.array([1, 2])).last_frame == -1


@pytest.mark.parametrize("takes", [True, False])
def test_a_system_that_takes_exposures_is_given_those_of_its_frames(takes):
    sequence = make_sequence(12, segment=None)
    sequence = replace(sequence, exposure_s=np.linspace(0.001, 0.012, 12)).only(np.arange(0, 12, 2))
    given = []

    class Exposed(FakeSystem):
        takes_exposure = takes

        def process(self, image, stamp_s, *exposure_s):
            given.append(exposure_s)
            return super().process(image, stamp_s)

    execute(sequence, "base", 0, build=lambda *_: Exposed(sequence.T_world_cam, starts_at=0))
    assert given == ([(e,) for e in sequence.exposure_s] if takes else [()] * 6)
