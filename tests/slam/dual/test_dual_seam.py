"""The seam of a fusion: slightly differing alignments are all taken into account."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import PointWorld, pose_error, rigid, walk

from dslab.slam.dual.fusion import fuse as fusion
from dslab.slam.dual.fusion.fuse import FusionConfig, confirms, fuse
from dslab.slam.dual.fusion.place_merging import inverted
from dslab.slam.loop_closing.map_alignment import align
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.optimization.sim3 import sim3_inverse, sim3_matrix

OLD = range(0, 35, 5)
NEW = range(20, 65, 5)
SCALE = 0.37
MOVED = rigid((2.0, -1.0, 3.0), (20, -35, 50))
CONFIG = FusionConfig()


@pytest.fixture(scope="module")
def sightings():
    rng = np.random.default_rng(22)
    world = PointWorld(seed=21)
    return world, {i: world.see(i, walk(i), rng, noise_px=0.5, bits=8) for i in range(0, 65, 5)}


@pytest.fixture(scope="module")
def built(sightings):
    world, seen = sightings
    rng = np.random.default_rng(23)
    old, _ = world.map_of([seen[i] for i in OLD], rng, noise=0.01)
    new, _ = world.map_of([seen[i] for i in NEW], rng, noise=0.01, map_id=1)
    new.transform(SCALE, MOVED[:3, :3], MOVED[:3, 3])
    found = [align(old, new, OLD.index(i), NEW.index(i), rng, CONFIG)[0] for i in (30, 20)]
    assert None not in found
    return old, new, found


@pytest.fixture
def maps(built):
    old, new, found = built
    return old.copy(), new.copy(), found


def changed(old, alignment, scale, shift):
    """A changed alignment, scaled and shifted about its own points."""
    where = old.arrays.pt_xyz[alignment.old_points].mean(0)
    off = rigid(where) @ rigid((shift, 0, 0)) @ sim3_matrix(scale, np.eye(3), np.zeros(3)) @ rigid(-where)
    S = off @ alignment.S_old_new
    return replace(alignment, S_old_new=S, scale=scale * alignment.scale)


@pytest.fixture
def without_adjustment(monkeypatch):
    """Fusion without bundle adjustment, which would correct the errors under test."""
    monkeypatch.setattr(fusion.LocalMapper, "adjust_keyframes", lambda self, free: None)
    monkeypatch.setattr(fusion, "_fuse_seam", lambda *args: None)


def misfits(fused, keyframes, placed, new):
    """Distance of each alignment's keyframe from the position given by the alignment."""
    misfit = []
    for a in placed:
        camera = a.S_old_new @ np.linalg.inv(new.T_cam_map(a.new_keyframe))
        is_at = np.linalg.inv(fused.T_cam_map(a.new_keyframe + keyframes))
        misfit.append(float(np.linalg.norm(camera[:3, 3] - is_at[:3, 3])))
    return misfit


@pytest.mark.usefixtures("without_adjustment")
def test_differing_alignments_are_both_satisfied_better_than_by_a_rigid_placement(maps, built):
    old, new, (first, last) = maps
    first, last = changed(old, first, 1.015, 0.08), changed(old, last, 0.985, -0.08)
    assert confirms(old, first, last, CONFIG)
    rigidly, both = old.copy(), old.copy()
    alone = fuse(rigidly, new.copy(), [last], LocalMappingConfig())
    settled = fuse(both, new.copy(), [first, last], LocalMappingConfig())
    check_map(both)
    before = misfits(rigidly, alone.keyframes, (first, last), built[1])
    after = misfits(both, settled.keyframes, (first, last), built[1])
    assert after[0] < 0.6 * before[0]
    assert max(after) < 0.6 * max(before)
    assert sum(np.square(after)) < 0.5 * sum(np.square(before))
    assert (alone.factor == 1).all()
    # Lengths around the keyframes lie between those of the two alignments.
    factor = settled.factor[settled.keyframes + NEW.index(30)]
    assert 1.0 < factor < 1.001 * first.scale / last.scale
    np.testing.assert_allclose(settled.factor[: settled.keyframes], 1, atol=1e-9)


@pytest.mark.usefixtures("without_adjustment")
def test_old_keyframes_are_fixed(maps):
    old, new, (first, last) = maps
    first = changed(old, first, 1.02, 0.05)
    before = {int(k): old.T_cam_map(int(k)) for k in old.keyframes()}
    fuse(old, new, [first, last], LocalMappingConfig())
    for k, T in before.items():
        np.testing.assert_allclose(old.T_cam_map(k), T, atol=1e-9)


def test_an_alignment_with_a_culled_keyframe_is_not_used(maps):
    """The result is the same as without it."""
    old, new, (first, last) = maps
    first = changed(old, first, 1.02, 0.05)
    gone = changed(old, replace(first, new_keyframe=NEW.index(25), old_keyframe=OLD.index(25)), 1.0, 0.3)
    new.cull_keyframe(NEW.index(25))
    empty = np.empty(0, np.int32)
    gone = replace(gone, old_points=empty, new_points=empty)
    with_it, without = old.copy(), old.copy()
    fuse(with_it, new.copy(), [gone, first, last], LocalMappingConfig())
    fuse(without, new.copy(), [first, last], LocalMappingConfig())
    for k in without.keyframes():
        np.testing.assert_array_equal(with_it.T_cam_map(int(k)), without.T_cam_map(int(k)))


def test_the_seam_becomes_edges_of_the_essential_graph(maps):
    old, new, (first, last) = maps
    fused = fuse(old, new, [first, last], LocalMappingConfig())
    for a in (first, last):
        assert (a.new_keyframe + fused.keyframes, a.old_keyframe) in old.loop_edges


def test_an_inverted_alignment_fuses_the_other_way(maps, sightings):
    """The older map may be the tracked one: it absorbs the saved one."""
    old, new, found = maps
    back = [inverted(a, new.map_id) for a in found]
    assert back[0].old_map_id == new.map_id and back[0].inliers == found[0].inliers
    # Here the second map is kept, in its own frame and scale.
    fused = fuse(new, old, back, LocalMappingConfig())
    check_map(new)
    S_world_map = sim3_inverse(sim3_matrix(SCALE, MOVED[:3, :3], MOVED[:3, 3]))
    for k, i in enumerate(OLD):
        camera = S_world_map @ np.linalg.inv(new.T_cam_map(fused.keyframes + k))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = camera[:3, :3] * SCALE, camera[:3, 3]
        distance, angle = pose_error(np.linalg.inv(T), sightings[1][i].T_cam_world)
        assert distance < 0.05 and angle < 0.4
