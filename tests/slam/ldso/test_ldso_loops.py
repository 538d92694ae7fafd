"""Loops: corners, similarity against a known one, pose graph, and the system end to end."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ldso_scenes import (
    CAMERA,
    CONFIG,
    INTRINSICS,
    POSES,
    RECTIFIER,
    motion,
    position_error,
    round_room,
    view,
)

from dslab.slam.core import events as ev
from dslab.slam.core.seeds import rng_for
from dslab.slam.direct.selection import select
from dslab.slam.factory import build_system
from dslab.slam.features._orb_kernels import BORDER_PX
from dslab.slam.ldso.corner_map import CornerMap, depths_of
from dslab.slam.ldso.corners import corner_view, corners_of, described, with_corners
from dslab.slam.ldso.loops import distributed
from dslab.slam.ldso.window import Keyframe
from dslab.slam.loop_closing.correction import move_map
from dslab.slam.loop_closing.map_alignment import Sim3AlignmentConfig, align
from dslab.slam.optimization.sim3 import sim3_matrix
from dslab.slam.optimization.sim3_algebra import invert_sim3, scales

VIEW = corner_view(CAMERA, CONFIG.corners)
DRIFT = sim3_matrix(1.2, motion([0, 0, 0, 0.05, -0.1, 0.08])[:3, :3], np.array([0.4, -0.2, 0.3]))


def keyframe_of(frame, T, S=None):
    """Keyframe with exact depths of its corners, in a map moved by a similarity."""
    image, depth = view(T)
    level = RECTIFIER.pyramid(image).levels[0]
    found, corner = with_corners(select(RECTIFIER.pyramid(image)), level, CONFIG.corners)
    features = described(level, found.xy[corner], frame, frame / 10, CAMERA, VIEW)
    scale = 1.0
    if S is not None:  # map to camera of the moved map, in its lengths
        scale = float(scales(S[None])[0])
        T = sim3_matrix(scale, np.eye(3), np.zeros(3)) @ T @ np.linalg.inv(S)
    xy = found.xy.astype(int)
    return Keyframe(
        frame, frame / 10, T, found.xy.astype(float), 1 / (scale * depth[xy[:, 1], xy[:, 0]]), features
    )


def test_corners_take_the_place_of_pixels_in_their_cells():
    level = RECTIFIER.pyramid(view(np.eye(4))[0]).levels[0]
    found = select(RECTIFIER.pyramid(view(np.eye(4))[0]))
    mixed, corner = with_corners(found, level, CONFIG.corners)
    assert 0.9 * len(found.xy) < len(mixed.xy) <= len(found.xy)
    assert 100 < corner.sum() < len(mixed.xy)
    all_corners = set(map(tuple, corners_of(level, CONFIG.corners)))
    assert all(tuple(xy) in all_corners for xy in mixed.xy[corner])
    assert set(map(tuple, mixed.xy[~corner])) <= set(map(tuple, found.xy))
    assert len(np.unique(mixed.xy, axis=0)) == len(mixed.xy)
    edge = np.tile(np.where(np.arange(320) < 160, 40.0, 200.0), (240, 1)).astype(np.uint8)
    assert not len(corners_of(RECTIFIER.pyramid(edge).levels[0], CONFIG.corners))


def test_corners_are_the_peaks_of_the_lesser_eigenvalue_away_from_what_is_unknown():
    """The same by whole planes, with OpenCV's filters."""
    level, config = RECTIFIER.pyramid(view(POSES[0])[0]).levels[0].copy(), CONFIG.corners
    everywhere = corners_of(level, config)
    x, y = everywhere[: len(everywhere) // 4 : 3].T
    level[y, x + 2, 0], level[y + 1, x, 2] = np.nan, np.inf  # beside some of the strongest
    known = np.isfinite(level).all(axis=2)
    gx, gy = np.where(known, level[..., 1], 0), np.where(known, level[..., 2], 0)
    window = (config.window_px, config.window_px)
    a, b, c = (cv2.blur(product, window) for product in (gx * gx, gx * gy, gy * gy))
    weaker = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
    inside = cv2.erode(known.astype(np.uint8), np.ones(window, np.uint8)) > 0
    inside[:BORDER_PX], inside[-BORDER_PX:] = False, False
    inside[:, :BORDER_PX], inside[:, -BORDER_PX:] = False, False
    peak = weaker == cv2.dilate(weaker, np.ones((config.apart_px, config.apart_px), np.uint8))
    rows, columns = np.nonzero(inside & peak & (weaker > config.least_gradient**2))
    best_first = np.argsort(-weaker[rows, columns], kind="stable")
    found = corners_of(level, config)
    np.testing.assert_array_equal(found, np.column_stack([columns, rows])[best_first])
    assert 100 < len(found) < len(everywhere)


def test_the_similarity_between_two_ends_is_the_known_one():
    """The same wall is mapped twice, the second time in a map moved, turned and scaled."""
    corners = CornerMap(0, VIEW, replace(CONFIG.corners, around=2))
    for number, T in enumerate(POSES[:2]):
        corners.insert(number, keyframe_of(number, T), INTRINSICS[0])
    there = [motion([0.05, 0.01, 0.0, 0.0, 0.01, 0.02]) @ T for T in POSES[:2]]
    for number, T in enumerate(there, 2):
        corners.insert(number, keyframe_of(number, T, DRIFT), INTRINSICS[0])
    m = corners.map
    assert len(m.neighbours(1, 9)) == 1 and len(m.neighbours(3, 9)) == 1  # nothing joins the two ends yet
    found, reason, matches = align(m, m, 0, 2, rng_for(1, "test"), Sim3AlignmentConfig(min_matches=40))
    assert found is not None and matches > 60, reason
    expected = np.linalg.inv(DRIFT)
    np.testing.assert_allclose(found.scale, scales(expected[None])[0], rtol=0.005)
    np.testing.assert_allclose(found.S_old_new, expected, atol=0.01)


def test_points_are_observed_again_where_depths_agree():
    corners = CornerMap(0, VIEW, CONFIG.corners)
    one, two = (keyframe_of(number, T) for number, T in enumerate(POSES[:2]))
    corners.insert(0, one, INTRINSICS[0])
    corners.insert(1, two, INTRINSICS[0])
    m = corners.map
    shared = np.intersect1d(m.observed_points(0), m.observed_points(1))
    assert (shared >= 0).sum() > 60
    assert np.isfinite(depths_of(one)).all() and m.arrays.pt_visible[: m.n_points].max() == 2
    wrong = CornerMap(0, VIEW, CONFIG.corners)
    wrong.insert(0, one, INTRINSICS[0])
    two.inverse_depth = two.inverse_depth * 1.3
    wrong.insert(1, two, INTRINSICS[0])
    assert (np.intersect1d(wrong.map.observed_points(0), wrong.map.observed_points(1)) < 0).all()


def test_a_moved_map_keeps_what_its_keyframes_see():
    corners = CornerMap(0, VIEW, CONFIG.corners)
    for number, T in enumerate(POSES[:2]):
        corners.insert(number, keyframe_of(number, T), INTRINSICS[0])
    m = corners.map

    def pixels():
        rows = np.flatnonzero(m.observed_points(0) >= 0)
        X = m.arrays.pt_xyz[m.observed_points(0)[rows]] @ m.T_cam_map(0)[:3, :3].T + m.T_cam_map(0)[:3, 3]
        return X[:, :2] / X[:, 2:]

    before = pixels()
    factor = move_map(m, m.arrays.kf_T_cam_map[:2] @ np.linalg.inv(DRIFT))
    np.testing.assert_allclose(factor, 1.2)
    np.testing.assert_allclose(pixels(), before, atol=1e-9)


def ring(n, scale_drift):
    """True poses on a circle, and estimates of which each is smaller than the one before by a factor."""
    true, found = [np.eye(4)], [np.eye(4)]
    for k in range(n):
        step = motion([0.3, 0, 0.05, 0, 2 * np.pi / n, 0])
        true.append(step @ true[-1])
        small = step.copy()
        small[:3, 3] *= scale_drift**k
        found.append(small @ found[-1])
    return np.array(true), np.array(found)


def test_drift_is_distributed_over_the_past_and_the_window_is_held():
    true, found = ring(40, 0.99)
    held = np.arange(41) > 35
    relative = true[-6] @ np.linalg.inv(true[0])
    s = 0.99**35  # lengths about keyframe 35 beside those of the first
    measured = sim3_matrix(s, np.eye(3), np.zeros(3)) @ relative
    S = distributed(found, found, [(35, 0, measured)], held)
    np.testing.assert_array_equal(S[held], found[held])
    misfit = S[35] @ invert_sim3(S[:1])[0] @ np.linalg.inv(measured)
    np.testing.assert_allclose(misfit, np.eye(4), atol=0.05)
    change = np.log(scales(S))[:36]
    assert (np.diff(change) * np.sign(change[-1] - change[0]) > 0).all()  # evenly, not in one place
    np.testing.assert_allclose(abs(change[-1] - change[0]), -np.log(s), rtol=0.1)


def test_a_loops_scale_counts_as_much_as_it_is_told():
    true, found = ring(40, 1.0)
    held = np.arange(41) > 35
    wrong = sim3_matrix(1.01, np.eye(3), np.zeros(3)) @ true[35] @ np.linalg.inv(true[0])
    change = [
        abs(np.log(scales(distributed(found, found, [(35, 0, wrong)], held, w)))).max() for w in (1, 0.01)
    ]
    assert change[0] > 0.009 and change[1] < 0.5 * change[0]


TURNS, COUNT, BRANCH = 1.25, 163, 120
WRONG = replace(CAMERA, fx=1.01 * CAMERA.fx, fy=1.01 * CAMERA.fy)  # by which a round is not closed


@pytest.fixture(scope="module")
def rounds():
    """A system that has gone round, its paths before and after every frame, a branch, and the truth."""
    frames = list(round_room(np.linspace(0, 2 * np.pi * TURNS, COUNT)))
    system, paths, branch = build_system("ldso", WRONG, 3), [], None
    for index, (image, _) in enumerate(frames):
        if index == BRANCH:
            branch = system.snapshot().restore()
        system.process(image, index / 30)
        paths.append(system.trajectories())
    for index in range(BRANCH, COUNT):
        branch.process(frames[index][0], index / 30)
    return system, paths, branch, np.array([T[:3, 3] for _, T in frames])


@pytest.mark.slow
def test_a_loop_is_closed_and_drift_shrinks(rounds):
    system, paths, _, centres = rounds
    closed = [e for e in system.events if isinstance(e, ev.LoopClosed)]
    assert closed
    for event in closed:
        apart = (event.keyframe - event.loop_keyframe) / (COUNT - 1) * TURNS
        assert abs(apart - 1) < 0.08 and event.matches >= 40 and event.relation is not None
    first = closed[0].frame
    before, after = (position_error(paths[k][0], centres) for k in (first - 1, first))
    assert after < before / 2
    moved_by = np.linalg.norm(
        paths[first - 1][0].T_map_cam[:, :3, 3] - paths[first][0].T_map_cam[:first, :3, 3], axis=1
    )
    assert moved_by[-3:].max() < 0.02 * moved_by[:3].min()  # the window is held, the past comes to it


@pytest.mark.slow
def test_every_correction_starts_from_what_odometry_and_loops_said(rounds):
    """Keyframes lie where one pose graph of all observations puts them, whatever was corrected before."""
    system, _, _, _ = rounds
    closer = system._closers[0]
    T = np.array([keyframe.T_cam_map for keyframe in closer._odometry.keyframes])
    moved = np.array(sorted(closer._T_odometry))
    alone = T.copy()
    alone[moved] = [closer._T_odometry[row] for row in moved]
    held = ~np.isin(np.arange(len(T)), moved)
    S = distributed(alone, alone, closer._loops, held, CONFIG.corners.scale_weight)
    at_once, found = (-np.linalg.inv(M[:, :3, :3]) @ M[:, :3, 3:] for M in (S, T))
    assert len(closer._loops) > 1 and np.abs(alone - T).max() > 0.01
    np.testing.assert_allclose(found, at_once, atol=1e-6)


@pytest.mark.slow
def test_nothing_is_closed_before_the_place_is_seen_again(rounds):
    system, _, _, _ = rounds
    whole = (COUNT - 1) / TURNS
    assert not [e for e in system.events if isinstance(e, ev.LoopClosed) and e.frame < whole - 25]


@pytest.mark.slow
def test_a_branch_closes_the_same_loops_bit_for_bit(rounds):
    system, _, branch, _ = rounds
    told = [[(e.kind, e.frame) for e in s.events] for s in (system, branch)]
    assert told[0] == told[1]
    for a, b in zip(system.trajectories(), branch.trajectories(), strict=True):
        np.testing.assert_array_equal(a.T_map_cam, b.T_map_cam)
