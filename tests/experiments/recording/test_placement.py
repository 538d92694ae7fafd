"""A new map is drawn in its own frame until it is fused, and then where the old map has it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation
from slam_fakes import CAMERA, FakeSystem, fake_factory, make_sequence

from dslab.experiments.evaluation.alignment import Similarity
from dslab.experiments.recording import Recording
from dslab.experiments.recording.drawing import MapSnapshot
from dslab.experiments.recording.paths import RunPaths
from dslab.experiments.recording.placement import Placements
from dslab.experiments.recording.viewpoint import Viewpoint
from dslab.experiments.runs.execution import RunRecord, execute, live_trajectories
from dslab.slam.core import events as ev
from dslab.slam.core.results import MapTrajectory

BREAKS, NEW_MAP, STARTS, FUSED = 160, 180, 222, 242
ASIDE = np.array([0.0, 0.0, -7.0])
GAUGE = Similarity(0.5, Rotation.from_euler("xyz", [1.0, 0.2, -0.4]).as_matrix(), np.array([9.0, 8.0, 7.0]))


def at(frame: int, map_id: int) -> dict:
    return {"frame": frame, "stamp_s": frame / CAMERA.fps, "map_id": map_id}


def alone() -> RunRecord:
    """Map 0 up to the breakage, then map 1 in a frame and scale of its own."""
    sequence = make_sequence()
    run = execute(sequence, "dual", 0, build=fake_factory(sequence, breaks_at=BREAKS, recovers=False))
    results = tuple(
        r if r.map_id == 0 or r.T_map_cam is None else replace(r, T_map_cam=GAUGE.poses(r.T_map_cam[None])[0])
        for r in run.results
    )
    live = live_trajectories(results)
    return replace(run, results=results, live=live, trajectories=tuple(live.values()))


def fused(stretched: float = 1.0) -> RunRecord:
    """Map 1 is fused into map 0 at last, and the frames in between are placed; the fusion may be wrong."""
    lone = alone()
    sequence = make_sequence()
    old = execute(sequence, "base", 0, build=fake_factory(sequence)).live[0]
    poses, seam = old.T_map_cam.copy(), old.T_map_cam[old.frames == BREAKS][0, :3, 3]
    later = old.frames > BREAKS
    poses[later, :3, 3] = seam + stretched * (poses[later, :3, 3] - seam)
    results = tuple(
        r if r.frame < FUSED else replace(r, map_id=0, T_map_cam=poses[old.frames == r.frame][0])
        for r in lone.results
    )
    thread = {"thread": 1, "method": "orb", "old_map_id": 0}
    end = next(e for e in lone.events if isinstance(e, ev.RecoveryEnd))
    given = {"old_map_id": 0, "new_map_id": 1, "by": "recovery", "accepted": True, "scale": 2.0, "inliers": 9}
    events = (
        *(e for e in lone.events if e is not end),
        ev.RecoveryStart(**at(STARTS, 1), **thread, buffered_frames=90),
        replace(end, frame=FUSED, success=True, stage="", reason=""),
        ev.Fusion(**at(FUSED, 0), **given, reason=""),
    )
    final = (MapTrajectory(0, old.frames, old.stamps_s, poses),)
    return replace(lone, results=results, live=live_trajectories(results), events=events, trajectories=final)


def drawn(maps: Placements, record: RunRecord, map_id: int, frame: int) -> np.ndarray:
    """(n, 3) live path of a map in the world, as drawn at a frame."""
    place, live = maps.at(map_id, frame), record.live[map_id]
    assert place is not None
    return place.S_world_map.points(live.T_map_cam[live.frames <= frame, :3, 3])


def truth(record: RunRecord, frames: np.ndarray) -> np.ndarray:
    assert record.sequence.T_world_cam is not None
    return record.sequence.T_world_cam[frames, :3, 3]


@pytest.mark.parametrize("make", [alone, fused])
def test_until_it_is_fused_a_map_begins_beside_where_the_old_one_ended_and_its_unit_is_the_old_ones(make):
    record = make()
    maps = Placements(record, ASIDE)
    path = drawn(maps, record, 1, FUSED - 1)
    np.testing.assert_allclose(path[0], truth(record, np.array([BREAKS - 1]))[0] + ASIDE, atol=1e-6)
    walked = np.linalg.norm(np.diff(truth(record, np.arange(NEW_MAP, FUSED)), axis=0), axis=1)
    # Half as large as it is: GAUGE halves its unit, and nothing is known of that before the fusion.
    np.testing.assert_allclose(np.linalg.norm(np.diff(path, axis=0), axis=1), 0.5 * walked, rtol=1e-6)
    np.testing.assert_allclose(drawn(maps, record, 0, BREAKS)[-1], truth(record, np.array([BREAKS - 1]))[0])


def test_a_map_without_a_fusion_stays_alone_and_dashed():
    record = alone()
    maps = Placements(record, ASIDE)
    place = maps.at(1, 299)
    assert place is not None and place.is_own and maps.stands_alone(1, 299)
    assert len(RunPaths(record, maps).live_strips(1, 299)) > 5
    assert len(RunPaths(record, maps).live_strips(0, 299)) == 1


def test_at_the_fusion_the_map_is_where_the_old_one_has_it():
    record = fused()
    maps = Placements(record, ASIDE)
    frames = record.live[1].frames
    np.testing.assert_allclose(drawn(maps, record, 1, FUSED), truth(record, frames), atol=1e-6)
    assert not maps.stands_alone(1, FUSED) and maps.stands_alone(1, FUSED - 1)
    assert len(RunPaths(record, maps).live_strips(1, FUSED)) == 1


def test_a_wrong_fusion_is_seen_as_only_the_old_map_is_aligned():
    record = fused(stretched=2.0)
    maps = Placements(record, ASIDE)
    old = truth(record, record.live[0].frames)
    before = record.live[0].frames < BREAKS
    np.testing.assert_allclose(drawn(maps, record, 0, 299)[before], old[before], atol=1e-6)
    wrong = drawn(maps, record, 1, FUSED) - truth(record, record.live[1].frames)
    assert np.linalg.norm(wrong, axis=1).min() > 0.5


def test_a_recovery_places_frames_backward_beside_the_old_map_until_the_fusion():
    record = fused()
    maps = Placements(record, ASIDE)
    paths = RunPaths(record, maps)
    assert paths.recovered_strips(STARTS) == []
    (half,) = paths.recovered_strips((STARTS + FUSED) // 2)
    (whole,) = paths.recovered_strips(FUSED)
    np.testing.assert_allclose(whole[:-1], truth(record, np.arange(BREAKS, NEW_MAP)), atol=1e-6)
    assert len(half) == 11 and len(whole) == 21  # each with its end once more
    end = drawn(maps, record, 1, FUSED - 1)
    step = np.linalg.norm(end[1] - end[0])
    assert np.linalg.norm(half[-1] - end[0]) == pytest.approx(step, rel=0.01)


def test_without_truth_the_first_map_is_in_its_own_frame_and_the_others_join_it():
    record = fused()
    blind = replace(record, sequence=replace(record.sequence, T_world_cam=None))
    maps = Placements(blind, ASIDE)
    final = record.trajectories[0]
    chosen = np.isin(final.frames, record.live[1].frames)
    np.testing.assert_allclose(drawn(maps, blind, 1, FUSED), final.T_map_cam[chosen, :3, 3], atol=1e-6)


def test_a_dropped_map_is_no_more():
    record = alone()
    dropped = ev.MapDropped(**at(250, 1), reason="smeared", keyframes=3)
    maps = Placements(replace(record, events=(*record.events, dropped)), ASIDE)
    assert maps.is_there(1, 249) and not maps.is_there(1, 250) and maps.is_there(0, 250)


@pytest.mark.parametrize("aspect", [0.6, 2.5])
def test_all_that_is_to_be_in_view_is_in_view_and_fills_it(aspect):
    view = Viewpoint(np.array([0.0, 0, 1]), np.array([0.0, 1, 0]), 0.0, 40.0)
    points = np.random.default_rng(0).uniform((-30, -5, 0), (10, 5, 3), (200, 3))
    eye, target = view.eye(points, aspect)
    towards = (eye - target) / np.linalg.norm(eye - target)
    depth = (eye - points) @ towards
    right = np.abs((points - eye) @ view.along) / depth / aspect
    upward = np.abs((points - eye) @ np.cross(towards, view.along)) / depth
    largest = max(right.max(), upward.max()) / np.tan(np.radians(55 / 2))
    assert 0.85 < largest < 1 and towards @ view.up > 0.5 and towards @ view.across < -0.5


def rows(path: Path, entity: str, name: str) -> dict[int, list]:
    """What a recording holds of a component of an entity, by frame."""
    found: dict[int, list] = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            columns = {k.rsplit(":", 1)[-1]: v for k, v in chunk.to_record_batch().to_pydict().items()}
            found |= dict(zip(columns["frame"], columns.get(name, []), strict=False))
    return found


def test_a_recording_moves_the_map_at_the_fusion_and_takes_its_points_and_its_label_away(tmp_path):
    run, path = fused(), tmp_path / "r.rrd"
    with Recording(path, run.sequence, ["dual"]) as recording:
        watcher = recording.watch("dual")
        watcher.snapshots += [
            MapSnapshot(f, m, np.ones((5, 3), np.float32)) for f, m in ((200, 1), (FUSED, 0))
        ]
        recording.finish([run])
    moved = rows(path, "/world/dual/map_1", "mat3x3")
    assert set(moved) == {NEW_MAP, FUSED}
    before, after = (np.cbrt(np.linalg.det(np.reshape(moved[f], (3, 3)))) for f in (NEW_MAP, FUSED))
    assert after == pytest.approx(2 * before)  # GAUGE halves its unit
    assert rows(path, "/world/dual/map_1/points", "is_recursive")[FUSED] == [False]
    labels = rows(path, "/world/dual/marks/maps", "labels")
    assert labels[NEW_MAP] == ["map 1: own scale"] and not labels[FUSED]
    placed = rows(path, "/world/dual/recovered", "strips")
    assert [len(strip) for strip in placed[STARTS + 10]] == [11] and set(range(STARTS, FUSED)) <= set(placed)


def test_the_map_is_shown_at_once_when_another_is_in_use(tmp_path):
    run = fused()
    system = FakeSystem(run.sequence.T_world_cam)
    system.maps, system.map_points = lambda: [0, 1], lambda _: np.ones((3, 3))  # type: ignore[method-assign]
    with Recording(tmp_path / "r.rrd", run.sequence, ["dual"]) as recording:
        watcher = recording.watch("dual")
        for result in run.results:
            watcher.frame(run.sequence.frames[result.frame], result, system)
        assert (FUSED, 0) in [(s.frame, s.map_id) for s in watcher.snapshots]
        recording.finish([run])


def test_a_run_without_truth_and_without_a_map_is_recorded(tmp_path):
    sequence = make_sequence(20, truth=False, segment=None)
    lost = FakeSystem(np.tile(np.eye(4), (20, 1, 1)), starts_at=99)
    with Recording(tmp_path / "r.rrd", sequence, ["base"]) as recording:
        recording.finish([execute(sequence, "base", 0, recording.watch("base"), build=lambda *_: lost)])
    assert rows(tmp_path / "r.rrd", "/slam/base/tracking", "state")[0] == ["initialising"]
