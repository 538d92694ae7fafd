"""What is believed against what is true: planted errors of poses, windows and matches are counted as such."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from slam_scenes import CAMERA, FPS, PointWorld, rigid, tracked_in, walk

from dslab.experiments.claims.belief import AXES, Belief, BeliefSpec
from dslab.experiments.claims.belief_figures import figures
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import RelativePose

SCALE = 0.5
"""Size of the map over that of the world."""
DEVIATIONS = np.array([0.01, 0.01, 0.01, 0.002, 0.002, 0.002])
"""Of a pose, in the map: units, then rad."""


@pytest.fixture(scope="module")
def seen():
    """A walk, its map at half its size, and the newest frame."""
    world, rng = PointWorld(seed=5), np.random.default_rng(6)
    sightings = [world.see(i, walk(i), rng, noise_px=0.3) for i in range(0, 46, 5)]
    built, point_of = world.map_of(sightings[:-1], rng)
    frame = tracked_in(built, point_of, sightings[-1], len(sightings) - 2)
    built.transform(SCALE, np.eye(3), np.zeros(3))
    frame.T_cam_map[:3, 3] *= SCALE
    frame.sought = frame.T_cam_map.copy(), 1e-8 * np.eye(6)
    camera = Intrinsics(CAMERA.width_px, CAMERA.height_px, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, FPS)
    true = np.array([np.linalg.inv(walk(i)) for i in range(46)])
    sequence = Sequence("walk", camera, np.arange(46) / FPS, [], true, None, (), {})
    place = {(built.map_id, int(p)): world.xyz[i] for i, p in enumerate(point_of) if p >= 0}
    return built, frame, sequence, place


def noted(seen, off=(0.0,) * 6, **planted):
    built, frame, sequence, place = seen
    belief = Belief(sequence, lambda frame: np.empty(0))
    belief._places = place
    frame = frame.copy()
    for name, value in planted.items():
        setattr(frame, name, value)
    T = rigid(off[:3], np.rad2deg(off[3:])) @ frame.T_cam_map @ np.linalg.inv(built.T_cam_map(8))
    pose = RelativePose(40, T, np.diag(DEVIATIONS**2))
    belief.note(45, pose, SimpleNamespace(tracker=SimpleNamespace(map=built, last=frame)))
    return belief.row()


@pytest.mark.parametrize("axis", range(6))
def test_a_pose_is_inside_by_its_own_deviations_at_the_scale_of_the_map(seen, axis):
    for sigmas, inside in ((3.0, 1), (4.0, 0)):
        row = noted(seen, off=sigmas * DEVIATIONS * np.eye(6)[axis])
        assert (row["poses"], row["inside"]) == (1, inside)
        assert row["chi2"] == pytest.approx(sigmas**2 / 6, rel=0.02)
        metres = 1 / SCALE if axis < 3 else 1.0
        expected = (sigmas * DEVIATIONS[axis] * metres) ** 2
        assert row[f"square_{AXES[axis]}"] == pytest.approx(expected, rel=0.02)


def test_true_matches_lie_in_their_windows_unless_these_are_elsewhere(seen):
    row = noted(seen)
    assert row["sought"] > 200 and row["in_window"] > 0.97 * row["sought"]
    aside = rigid(rotvec_deg=(0, 2, 0)) @ seen[1].T_cam_map  # 17 px
    assert noted(seen, sought=(aside, 1e-8 * np.eye(6)))["in_window"] < 0.5 * row["sought"]
    wide = np.diag([1e-8] * 3 + [np.deg2rad(2) ** 2] * 3)
    assert noted(seen, sought=(aside, wide))["in_window"] > 0.97 * row["sought"]


def test_a_match_with_another_place_is_wrong(seen):
    assert noted(seen)["wrong"] == 0
    point = seen[1].point.copy()
    matched = np.flatnonzero(point >= 0)
    point[matched] = np.roll(point[matched], 7)
    row = noted(seen, point=point)
    assert row["wrong"] > 0.95 * row["taken"] > 100


def test_figures_are_means_of_worlds_and_a_likelihood_is_held_against_the_other_worlds(tmp_path):
    rng = np.random.default_rng(7)
    spec = BeliefSpec(
        kind="belief",
        name="b",
        claim="c",
        section="s",
        root_seed=1,
        worlds=20,
        bases={"room": {"world": {"kind": "room"}}},
    )
    rows = []
    for world in range(20):
        deviation = 10.0 ** rng.uniform(-1, 1)  # by which the system knows its worlds apart
        errors = deviation * rng.normal(size=(200, 6))
        density = -0.5 * (errors**2 / deviation**2 + np.log(2 * np.pi * deviation**2)).sum(axis=1)
        rows.append(
            {"world": world, "condition": "room", "system": "base", "poses": 200, "inside": 190, "chi2": 1.0,
             "likelihood": density.mean(), "sought": 100, "in_window": 99, "taken": 100, "wrong": world % 2}
            | {f"square_{axis}": s for axis, s in zip(AXES, (errors**2).mean(axis=0), strict=True)}
        )  # fmt: skip
    (row,) = figures(spec, pd.DataFrame(rows))["rows"]
    assert row["worlds"] == 20 and row["gain"]["low"] > 1
    assert row["inside"]["value"] == pytest.approx(0.95) and row["wrong"]["value"] == pytest.approx(0.005)
    constant = pd.DataFrame(rows).assign(likelihood=-100.0)
    assert figures(spec, constant)["rows"][0]["gain"]["high"] < 0
