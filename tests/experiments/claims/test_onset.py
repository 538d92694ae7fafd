"""A map that is made to go wrong at a known frame is found wrong from there; a right one never is."""

from dataclasses import dataclass, field, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from slam_fakes import CAMERA, make_sequence

from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.loading import load_claim
from dslab.experiments.claims.onset.rule import StepBounds, causes, onset, unusual_bounds
from dslab.experiments.claims.onset.unit import OnsetSpec, read_series, watched
from dslab.experiments.claims.onset.watch import StepJudge
from dslab.experiments.evaluation.metrics import Truth
from dslab.scenarios.spec import Scenario
from dslab.slam.core import events as ev
from dslab.slam.core.events import TrackingState
from dslab.slam.core.results import MapTrajectory, TrackingResult

FRAMES, EVERY, WALL_M, SCALE, STRESSED_S = 240, 4, 5.0, 0.4, 4.0
"""A camera walks along a wall; a keyframe every so many frames."""


def walk():
    T = np.tile(np.eye(4), (FRAMES, 1, 1))
    T[:, 0, 3] = np.arange(FRAMES) / CAMERA.fps
    return T


SEQUENCE = replace(make_sequence(FRAMES, segment=(120, 150)), T_world_cam=walk())
CALM = replace(SEQUENCE, segments=())
JUDGE = StepJudge(Truth.of(SEQUENCE), CAMERA, lambda frame: np.full((48, 64), WALL_M, np.float32))


@dataclass
class MappingFake:
    """Replays the walk and maps the wall.

    Attributes:
        breaks_at: frame of the breakage.
        depths_from: frame from which new points lie half as far again.
        jump_at: frame from which poses are half a metre aside.
        grow_from: frame from which steps and depths are half as long again.
    """

    breaks_at: int | None = None
    depths_from: int = FRAMES
    jump_at: int = FRAMES
    grow_from: int = FRAMES
    events: list = field(default_factory=list)

    def __post_init__(self):
        T = walk()
        T[:, 0, 3] += 0.5 * np.maximum(T[:, 0, 3] - T[self.grow_from - 1, 0, 3], 0)
        T[self.jump_at :, 1, 3] += 0.5
        T[:, :3, 3] *= SCALE
        self._T, self._points, self._frame = T, [], -1
        self._rng = np.random.default_rng(0)

    def process(self, image, stamp_s):
        self._frame += 1
        f = self._frame
        tracks = self.breaks_at is None or f < self.breaks_at
        if f == self.breaks_at:
            self.events.append(ev.Breakage(frame=f, stamp_s=stamp_s, map_id=0, reason="few", inliers=3))
        if tracks and f % EVERY == 0:
            seen = np.column_stack([self._rng.uniform(-2, 2, (30, 2)), np.full(30, WALL_M)]) * SCALE
            self._points.extend(
                seen * (1.5 if f >= min(self.depths_from, self.grow_from) else 1.0) + self._T[f, :3, 3]
            )
        state = TrackingState.TRACKING if tracks else TrackingState.LOST
        pose, nothing = self._T[f] if tracks else None, np.empty(0)
        return TrackingResult(f, stamp_s, state, pose, 0, 40, 60, "", f % EVERY == 0, nothing, nothing)

    def finish(self):
        pass

    def maps(self):
        return [0]

    def map(self, map_id):
        xyz = np.array(self._points)
        arrays = SimpleNamespace(pt_xyz=xyz, pt_bad=np.zeros(len(xyz), bool))
        return SimpleNamespace(n_points=len(xyz), arrays=arrays)

    def trajectories(self, every=1):
        frames = np.arange(0, self._frame + 1, every)
        return [MapTrajectory(0, frames, SEQUENCE.stamps_s[frames], self._T[frames])]

    def keyframe_trajectories(self):
        return self.trajectories(EVERY)


def run(sequence=SEQUENCE, **fault):
    unit = {"system": "base", "seed": 0}
    return watched(unit, sequence, JUDGE, STRESSED_S, lambda *_: MappingFake(**fault))


def found(**fault):
    row, *steps = run(**fault)
    return onset(steps, row["last_frame"], StepBounds())


@pytest.mark.parametrize("breaks_at", [None, 201])
def test_a_right_map_is_never_wrong(breaks_at):
    row, *steps = run(breaks_at=breaks_at)
    assert (row["outcome"], row["exposed"]) == ("held" if breaks_at is None else "broke", 1)
    assert (row["declared_frame"], row["true_loss_frame"]) == (breaks_at, breaks_at)
    assert all(onset(steps, end, StepBounds()).frame is None for end in range(row["last_frame"] + 1))
    assert max(step["depth_error"] for step in steps if step["depth_error"] is not None) < 1e-3
    assert abs(steps[-1]["metres_per_unit"] * SCALE - 1) < 1e-3


def test_a_map_is_wrong_from_the_first_of_its_wrong_points():
    at = found(depths_from=170, breaks_at=201)
    assert (at.frame, at.cause) == (172, "points")


def test_a_map_is_wrong_from_the_keyframe_behind_a_jump_of_its_poses():
    at = found(jump_at=181, breaks_at=201)
    assert (at.frame, at.cause) == (184, "poses")


def test_a_jump_is_in_the_live_pose_before_it_is_in_the_map():
    row = run(jump_at=181, breaks_at=201)[0]
    before_m, behind_m = read_series(row, "offset_m")[[180, 181]]
    assert before_m < 0.01 and behind_m > 0.45
    assert row["true_loss_frame"] == 181


def test_a_map_that_grows_is_wrong_once_its_scale_is_out_of_bounds():
    row, *steps = run(grow_from=150)
    at = onset(steps, row["last_frame"], StepBounds())
    assert at.frame is not None and 150 < at.frame <= 150 + 2 * CAMERA.fps
    assert steps[-1]["scale_ratio"] == pytest.approx(1.5, rel=0.01)
    assert causes(steps[-1], StepBounds()) == ("scale",)


def test_what_is_right_again_before_the_end_is_not_wrong():
    row, *steps = run(depths_from=170)
    steps[-1]["depth_error"] = 0.01
    assert onset(steps, row["last_frame"], StepBounds()).frame is None


def test_a_map_is_unusual_beyond_a_multiple_of_what_others_show():
    row, *steps = run()
    calm = [step | {"depth_error": 0.01} for step in steps]
    bounds = unusual_bounds([calm], 3)
    assert bounds is not None and bounds.points == pytest.approx(0.03)
    for error, frame in ((0.02, None), (0.04, steps[-1]["frame"])):
        found = onset([*calm[:-1], steps[-1] | {"depth_error": error}], row["last_frame"], bounds)
        assert found.frame == frame
    assert unusual_bounds([], 3) is None


def test_a_unit_without_a_map_is_void():
    (row,) = run(breaks_at=60)
    assert (row["outcome"], row["void_reason"]) == ("void", "broke in the lead-in")


# -- over worlds ---------------------------------------------------------------------------------------------


@cache
def one_of(is_stressed, is_wrong):
    if not is_stressed:
        return run(CALM)
    return run(breaks_at=204, depths_from=171 if is_wrong else FRAMES)


def table(spec, wrong_worlds):
    """Every stressed unit breaks, in these worlds a second after its map is wrong; no unstressed one does."""
    rows = []
    for place, unit in enumerate(KINDS["onset"].units(spec)):
        of_unit = one_of(unit["stress"] != "sham", unit["world"] in wrong_worlds)
        rows += [{"unit": place, **unit, "world_seed": 1, "sequence_seed": 2, **row} for row in of_unit]
    return pd.DataFrame(rows)


@pytest.mark.parametrize(
    ("wrong", "verdict"), [(range(12), "holds"), ((), "does not hold"), (range(6), "not decided")]
)
def test_the_verdict_follows_from_the_share_of_maps_that_were_wrong_before(wrong, verdict):
    spec = OnsetSpec.model_validate(
        load_claim("onset").model_dump() | {"worlds": 12, "bases": BASES, "degradations": STRESS}
    )
    figures = KINDS["onset"].figures(spec, table(spec, wrong))
    base = figures["systems"]["base"]
    share = base["stress"]["motion_blur"]["wrong"]["before_declared"]
    assert base["verdict"].startswith(verdict)
    assert [share[t]["value"] for t in ("0.1", "0.5", "1")] == [len(wrong) / 12] * 3
    assert share["1"]["worlds"] == 12
    assert base["stress"]["all"]["wrong"]["view_fails"]["value"] == 1 - len(wrong) / 12
    assert base["stress"]["sham"]["silent"]["value"] == base["placebo"]["wrong"]["random"]["0"]["value"] == 0
    assert base["placebo"]["wrong"]["excess"]["0.1"]["value"] == len(wrong) / 12
    longest = figures["telling"]["base"]["longest"]
    assert longest is None if not wrong else (longest["wrong_s"], longest["cause"]) == (1.0667, "points")
    KINDS["onset"].draw(spec, figures, 7.6)


BASES = {"room": {"world": {"kind": "room"}}}
STRESS = [{"kind": "motion_blur", "dose": "exposure_s", "doses": [0.1]}]


def test_the_preset_has_every_condition_in_every_world():
    spec = load_claim("onset")
    units = KINDS["onset"].units(spec)
    assert len(units) == 30 * (2 + 9) * len(spec.systems) and spec.worlds == 30
    assert len({(u["base"], u["world"], u["seed"]) for u in units}) == 60
    scenario = spec.scenario("corridor/fog-creeping/1", 3)
    assert isinstance(scenario, Scenario) and scenario.segments[0].ramp_s == 4.0


def test_a_system_without_points_in_a_map_is_refused():
    with pytest.raises(ValueError, match="ldso is no system"):
        OnsetSpec.model_validate(load_claim("onset").model_dump() | {"systems": ["ldso"]})


@pytest.mark.slow
def test_a_real_map_is_right_by_exact_depth_and_the_same_each_time(tmp_path):
    spec = load_claim("onset").model_copy(update={"lead_in_s": 3.0, "exposed_s": 0.5, "tail_s": 0.5})
    unit = KINDS["onset"].units(spec)[0]
    row, *steps = rows = KINDS["onset"].measure(spec, unit)
    assert row["outcome"] == "held" and onset(steps, row["last_frame"], StepBounds()).frame is None
    assert max(step["depth_error"] for step in steps if step["depth_error"] is not None) < 0.05
    assert sum(step["points"] for step in steps) > 500
    assert KINDS["onset"].measure(spec, unit) == rows
    KINDS["onset"].record(spec, unit, tmp_path / "unit.rrd")
    assert (tmp_path / "unit.rrd").stat().st_size > 100_000
