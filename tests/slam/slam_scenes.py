"""Synthetic maps, point worlds and short image sequences shared by the tests of ``slam``."""

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Features, Frame, FrameFeatures
from dslab.slam.core.geometry import view_geometry
from dslab.slam.core.results import MapTrajectory
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import ThreadSpec
from dslab.slam.factory import build_system
from dslab.slam.initialization.initializer import Initializer
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.invariants import check_map
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import horn_sim3
from dslab.slam.toy_sequence import CAMERA as TOY_CAMERA
from dslab.slam.toy_sequence import toy_frames

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0)
VIEW = view_geometry(CAMERA, 8, 1.2)
FPS = 30.0
NO_POINT = -1


# -- random maps ---------------------------------------------------------------------------------------------


def make_frame(index, rng, n=60, T=None):
    """A frame of random keypoints, one step of 0.1 to the right per index."""
    features = Features(
        xy=rng.uniform((0, 0), (639, 479), (n, 2)).astype(np.float32),
        octave=rng.integers(0, 8, n).astype(np.int32),
        angle_deg=rng.uniform(0, 360, n).astype(np.float32),
        response=np.ones(n, np.float32),
        descriptors=rng.integers(0, 2**63, (n, 4)).astype(np.uint64),
    )
    frame = Frame(FrameFeatures.build(index, index / FPS, features, CAMERA, VIEW))
    frame.T_cam_map = np.eye(4) if T is None else T
    frame.T_cam_map[0, 3] = -0.1 * index
    return frame


def random_map(rng, keyframes=6, points=80, map_id=0):
    """A map of random associations: valid to ``check_map``, without geometric meaning."""
    built = Map(map_id, VIEW)
    for k in range(keyframes):
        built.add_keyframe(make_frame(k, rng), k - 1)
    for _ in range(points):
        seen_by = rng.permutation(keyframes)[: rng.integers(2, keyframes + 1)]
        rows = [rng.integers(built.keypoints(k).start, built.keypoints(k).stop) for k in seen_by]
        rows = [r for r in rows if built.arrays.kp_point[r] < 0]
        if len(rows) < 2:
            continue
        p = built.create_point(rng.normal((0, 0, 5), 1, 3), rows[0])
        for r in rows[1:]:
            kernels.add_observation(built.arrays, r, p)
    return built


def scene(rng, n=400):
    """A map of one keyframe at the origin whose points project exactly onto its keypoints."""
    frame = make_frame(0, rng, n=n)
    m = Map(0, VIEW)
    m.add_keyframe(frame, -1)
    f = frame.features
    depth = rng.uniform(3, 8, n)
    rays = np.column_stack([(f.xy - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy), np.ones(n)])
    for i in range(n):
        frame.point[i] = m.create_point(rays[i] * depth[i], i)
    return m, frame


def seen_from(m, frame, T_cam_map):
    """The frame of a camera at another pose: same descriptors, moved keypoints."""
    xyz = m.arrays.pt_xyz[frame.point] @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
    xy = xyz[:, :2] / xyz[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
    f = frame.features
    inside = ((xy > 1) & (xy < (638, 478))).all(1)
    features = Features(
        xy[inside].astype(np.float32), f.octave[inside], f.angle_deg[inside],
        np.ones(inside.sum(), np.float32), f.descriptors[inside],
    )  # fmt: skip
    truth = {tuple(d): p for d, p in zip(f.descriptors.tolist(), frame.point.tolist(), strict=True)}
    return Frame(FrameFeatures.build(1, 1 / FPS, features, CAMERA, VIEW)), truth


# -- a world of points ---------------------------------------------------------------------------------------


def rigid(t=(0.0, 0.0, 0.0), rotvec_deg=(0.0, 0.0, 0.0)):
    """(4, 4) rigid motion."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec_deg, degrees=True).as_matrix()
    T[:3, 3] = t
    return T


def walk(i, step=0.06):
    """T_cam_world of frame ``i``: to the right, with small motions in all other directions."""
    T_world_cam = rigid((step * i, 0.08 * np.sin(i / 9), 0.1 * np.sin(i / 15)), (0, 3 * np.sin(i / 20), 1))
    return np.linalg.inv(T_world_cam)


@dataclass
class Sighting:
    """A frame, and the world point of each of its keypoints, -1 for none."""

    frame: Frame
    ids: np.ndarray
    T_cam_world: np.ndarray

    def again(self):
        """The same image as a new frame, without matches and pose."""
        return Frame(self.frame.features)

    def rows_of(self, ids):
        """Rows of the keypoints of any of these points."""
        return np.flatnonzero(np.isin(self.ids, ids) & (self.ids >= 0))


class PointWorld:
    """Points along a path, each with its own descriptor and size.

    Observations are those of a perfect detector, with noise on request, so that tests know the world point of
    every keypoint.
    """

    def __init__(self, seed=0, points=4000, reach=(-3.0, 16.0)):
        rng = np.random.default_rng(seed)
        self.xyz = np.column_stack(
            [rng.uniform(*reach, points), rng.uniform(-2.5, 2.5, points), rng.uniform(3.5, 8.0, points)]
        )
        self.descriptor = rng.integers(0, 2**64, (points, 4), dtype=np.uint64)
        self.angle_deg = rng.uniform(0, 360, points)
        # Distance at which the point appears on level 0.
        self.size = rng.uniform(5.0, 14.0, points)

    def see(self, index, T_cam_world, rng, noise_px=0.0, bits=0, share=0.7, clutter=40):
        """Simulate the frame of a camera.

        Args:
            index: frame number.
            T_cam_world: pose.
            rng: stream of the noise.
            noise_px: standard deviation of the keypoints on level 0.
            bits: descriptor bits flipped per observation.
            share: share of the points in view that are detected.
            clutter: keypoints without a world point.
        """
        xyz = self.xyz @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = xyz[:, :2] / xyz[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
        seen = (xyz[:, 2] > 0.5) & (xy > 4).all(1) & (xy < (635, 475)).all(1)
        seen &= rng.random(len(xyz)) < share
        ids = np.flatnonzero(seen)
        level = np.round(np.log(self.size[ids] / np.linalg.norm(xyz[ids], axis=1)) / VIEW.log_scale)
        octave = np.clip(level, 0, 7).astype(np.int32)
        xy = xy[ids] + noise_px * VIEW.scale[octave][:, None] * rng.normal(size=(len(ids), 2))
        descriptor = self.descriptor[ids]
        for _ in range(bits):
            word, bit = rng.integers(0, 4, len(ids)), rng.integers(0, 64, len(ids), dtype=np.uint64)
            descriptor[np.arange(len(ids)), word] ^= np.uint64(1) << bit
        features = Features(
            xy=np.concatenate([xy, rng.uniform((4, 4), (635, 475), (clutter, 2))]).astype(np.float32),
            octave=np.concatenate([octave, rng.integers(0, 8, clutter)]).astype(np.int32),
            angle_deg=np.concatenate([self.angle_deg[ids], rng.uniform(0, 360, clutter)]).astype(np.float32),
            response=np.ones(len(ids) + clutter, np.float32),
            descriptors=np.concatenate([descriptor, rng.integers(0, 2**64, (clutter, 4), dtype=np.uint64)]),
        )
        frame = Frame(FrameFeatures.build(index, index / FPS, features, CAMERA, VIEW))
        where = {tuple(p): i for p, i in zip(features.xy.tolist(), ids.tolist(), strict=False)}
        shown = [where.get(tuple(p), NO_POINT) for p in frame.features.xy_image.tolist()]
        return Sighting(frame, np.array(shown), T_cam_world)

    def map_of(self, sightings, rng, noise=0.0, keep=1.0, map_id=0):
        """Build a map in the world's frame: a keyframe per sighting, a point per world point seen twice.

        Args:
            sightings: the frames of the keyframes.
            rng: stream of the noise.
            noise: standard deviation of the points, metres.
            keep: share of the points in the map.
            map_id: id of the map.

        Returns:
            The map, and the map point of each world point, -1 for none.
        """
        built = Map(map_id, VIEW)
        point_of = np.full(len(self.xyz), NO_POINT)
        for k, sighting in enumerate(sightings):
            frame = sighting.again()
            frame.T_cam_map = sighting.T_cam_world.copy()
            built.add_keyframe(frame, k - 1)
        shown = np.concatenate([s.ids for s in sightings])
        ids, counts = np.unique(shown[shown >= 0], return_counts=True)
        ids = ids[(counts >= 2) & (rng.random(len(ids)) < keep)]
        for i in ids:
            rows = np.flatnonzero(shown == i)
            p = built.create_point(self.xyz[i] + noise * rng.normal(size=3), int(rows[0]))
            for row in rows[1:]:
                kernels.add_observation(built.arrays, int(row), p)
            kernels.refresh_point(built.arrays, p, VIEW)
            point_of[i] = p
        return built, point_of


def tracked_in(built, point_of, sighting, reference, T_cam_map=None):
    """The sighting as a frame tracked in a map of the world, with true matches and a given or true pose."""
    frame = sighting.again()
    frame.point[:] = np.where(sighting.ids >= 0, point_of[sighting.ids], NO_POINT)
    frame.T_cam_map = (sighting.T_cam_world if T_cam_map is None else T_cam_map).copy()
    frame.reference_keyframe = reference
    frame.T_cam_reference = frame.T_cam_map @ np.linalg.inv(built.T_cam_map(reference))
    return frame


def world_ids(built, sightings):
    """World point of each map point, and a mask of the points with observations of that one only.

    Args:
        built: the map, whose keyframe rows are those of ``sightings``.
        sightings: one per keyframe.

    Returns:
        ids (n_points,), -1 for dropped points and for those of clutter; pure (n_points,) bool.
    """
    shown = np.concatenate([s.ids for s in sightings])
    owner = built.arrays.kp_point[: len(shown)]
    ids = np.full(built.n_points, NO_POINT)
    pure = np.ones(built.n_points, bool)
    for p in built.points():
        seen = np.unique(shown[owner == p])
        ids[p], pure[p] = seen[0], len(seen) == 1 and seen[0] >= 0
    return ids, pure


def pose_error(T, truth):
    """(distance of the centres, angle in degrees) between two poses."""
    centre = np.linalg.inv(T)[:3, 3] - np.linalg.inv(truth)[:3, 3]
    angle = Rotation.from_matrix(T[:3, :3] @ truth[:3, :3].T).magnitude()
    return float(np.linalg.norm(centre)), float(np.rad2deg(angle))


# -- short image sequences -----------------------------------------------------------------------------------


def toy(count, seed=0, step_m=0.03):
    """A synthetic sequence: images, stamps (n,), T_world_cam (n, 4, 4). Shared: read only.

    It is the start of a longer one, so that tests of different lengths share it.
    """
    images, stamps_s, T_world_cam = _toy(190 if seed == 0 or count > 120 else 120, seed, step_m)
    return images[:count], stamps_s[:count], T_world_cam[:count]


@cache
def _toy(count, seed, step_m):
    images, stamps_s, T_world_cam = zip(*toy_frames(count, seed=seed, step_m=step_m), strict=True)
    return list(images), np.array(stamps_s), np.array(T_world_cam)


def blanked(images, *spans):
    """The images, blank in the given ranges."""
    blank = np.full_like(images[0], 120)
    return [blank if any(i in span for span in spans) else image for i, image in enumerate(images)]


def feed(system, images, stamps_s, check=True):
    """Run a system over frames and finish it.

    With ``check``, all maps are checked after every frame that can change their structure, those with a
    keyframe or an event, and at the end.
    """
    results = []
    for image, stamp_s in zip(images, stamps_s, strict=True):
        events = len(system.events)
        results.append(system.process(image, float(stamp_s)))
        if check and (results[-1].is_keyframe or len(system.events) > events):
            check_maps(system)
    system.finish()
    if check:
        check_maps(system)
    return results


def feed_until(system, images, stamps_s, kind):
    """Feed frames up to the first event of a kind, without finishing; the frames fed."""
    for i, (image, stamp_s) in enumerate(zip(images, stamps_s, strict=True)):
        system.process(image, float(stamp_s))
        if kind in kinds(system):
            return i + 1
    raise AssertionError(f"no {kind} in {len(images)} frames: {kinds(system)}")


def check_maps(system):
    """Check the invariants of all maps of a system."""
    for map_id in system.maps():
        check_map(system.map(map_id))


def kinds(system):
    """The kinds of a system's events, in order."""
    return [event.kind for event in system.events]


def errors_m(trajectory: MapTrajectory, T_world_cam):
    """Position errors after alignment by Sim(3), and metres per map unit."""
    estimate = trajectory.T_map_cam[:, :3, 3]
    truth = T_world_cam[trajectory.frames, :3, 3]
    s, R, t = horn_sim3(truth, estimate)
    return np.linalg.norm(s * estimate @ R.T + t - truth, axis=1), s


def rms(values):
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def fingerprint(system):
    """Digest of a system's poses, maps and events, bit by bit, without CPU times."""
    digest = hashlib.sha256()
    for path in (*system.trajectories(), *system.keyframe_trajectories()):
        for array in (path.frames, path.stamps_s, path.T_map_cam):
            digest.update(np.ascontiguousarray(array).tobytes())
    for map_id in system.maps():
        digest.update(system.map_points(map_id).tobytes())
    for event in system.events:
        record = {k: v for k, v in event.record().items() if k != "cpu_ms"}
        digest.update(json.dumps(record, sort_keys=True).encode())
    return digest.hexdigest()


def on_one_core(module, call):
    """Output of a function of a test module in another process, on one core if possible."""
    script = (
        "import os\n"
        "if hasattr(os, 'sched_setaffinity'): os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        f"import {module}; print({module}.{call})"
    )
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(here.parents[1]), str(here)])}
    command = [sys.executable, "-c", script]
    child = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert child.returncode == 0, child.stderr
    return child.stdout.strip()


def digest_of_run(kind, count, *spans):
    """Run a system over a toy sequence that is blank in ``spans`` of (first, end).

    Returns:
        Its fingerprint and the kinds of its events, as one line.
    """
    images, stamps_s, _ = toy(count, step_m=0.05)
    dual = DualConfig(recovery_threads=(ThreadSpec("orb"),), relocalization=False, place_merging=None)
    system = build_system(kind, TOY_CAMERA, 0, dual=dual)
    feed(system, blanked(images, *(range(*span) for span in spans)), stamps_s, check=False)
    return " ".join([fingerprint(system), *kinds(system)])


def reconfigure(system, **changes):
    """Change settings of a system that has begun."""
    engine = system.engine
    engine.config = replace(engine.config, **changes)
    engine.search._config = engine.store._config = engine.config


# -- starts --------------------------------------------------------------------------------------------------


class Accuser:
    """A second motion that is found right at a frame; see :class:`slam.initialization.second_motion`."""

    def __init__(self, at):
        self.at, self.verdict = at, ""

    def note(self, frame):
        self.verdict = "second" if frame.features.index >= self.at else ""


def accuse(monkeypatch, begun, at):
    """Let maps whose second view is one of the frames ``begun`` turn out wrong at frame ``at``."""

    def second_motion(_, geometry, first, second):
        return Accuser(at) if second.features.index in begun else None

    monkeypatch.setattr(Initializer, "_second_motion", second_motion)
