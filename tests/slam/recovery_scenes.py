"""Recovery tasks of real runs over toy images, for the tests of the recovery threads."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from dual_scenes import STEP_M, with_own_threads
from slam_scenes import blanked, errors_m, feed, toy

from dslab.slam.core.results import MapTrajectory
from dslab.slam.dual.recovery.interface import RecoveryCost, RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.registry import ThreadSpec, build_thread
from dslab.slam.map.trajectory import keyframe_trajectory

BLIND = range(50, 56)
FADED = range(50, 80)
SMEARED = range(50, 72)
_FADED_CONTRAST = 0.05
_FADED_SPEED = 3


@dataclass(frozen=True)
class Scene:
    """Task of a recovery thread in a run, the images of the run and the truth (n, 4, 4)."""

    task: RecoveryTask
    images: list
    T_world_cam: np.ndarray

    def again(self, seed=0):
        """A fresh copy of the task."""
        task = self.task
        return replace(
            task,
            new_map=task.new_map.copy(),
            first=task.first.copy(),
            rng=np.random.default_rng(seed),
            image_of=lambda index: self.images[index],
        )

    def run(self, kind, config=None, blind=()):
        """Result of a thread of a kind, with more blank frames than the run had."""
        task = self.again()
        if blind:
            frames = [f if f.index not in blind else _without_features(f) for f in task.backward]
            images = blanked(self.images, blind)
            task = replace(task, backward=frames, image_of=lambda index: images[index])
        return build_thread(ThreadSpec(kind, config=config)).run(task)

    def scale_error(self, result):
        """Relative error of an alignment's scale."""
        alignment = result.alignment
        old = next(m for m in self.task.old_maps if m.map_id == alignment.old_map_id)
        seam = old.frame_index(alignment.old_keyframe)
        metres_old = self._metres(keyframe_trajectory(old), seam)
        metres_new = self._metres(keyframe_trajectory(self.task.new_map), self.task.first.features.index)
        return alignment.scale * metres_old / metres_new - 1

    def errors_m(self, result):
        """Position error of every placed frame, by frame, after alignment with the truth."""
        forward = keyframe_trajectory(self.task.new_map)
        placed = [
            np.linalg.inv(f.T_cam_reference @ result.map.T_cam_map(f.reference_keyframe))
            for f in result.frames
        ]
        frames = [f.features.index for f in result.frames]
        path = MapTrajectory(
            forward.map_id,
            np.concatenate([forward.frames, frames]).astype(forward.frames.dtype),
            np.concatenate([forward.stamps_s, np.array(frames) / 30.0]),
            np.concatenate([forward.T_map_cam, placed]),
        )
        return dict(zip(frames, errors_m(path, self.T_world_cam)[0][len(forward.frames) :], strict=True))

    def _metres(self, path, frame):
        near = np.sort(np.argsort(np.abs(path.frames - frame), kind="stable")[:8])
        part = replace(
            path, frames=path.frames[near], stamps_s=path.stamps_s[near], T_map_cam=path.T_map_cam[near]
        )
        return errors_m(part, self.T_world_cam)[1]


class _Recording:
    """A thread that only records its task."""

    name = "given"
    needs_images = False
    cost = RecoveryCost(0.0, 0.0, 0.0)

    def __init__(self):
        self.tasks = []

    def run(self, task):
        self.tasks.append(replace(task, new_map=task.new_map.copy(), first=task.first.copy()))
        return RecoveryResult(task.new_map, stage="propagation", reason="not_tried")


def _scene(images, T_world_cam):
    given = _Recording()
    system = with_own_threads([given])
    for image, stamp_s in zip(images, np.arange(len(images)) / 30.0, strict=True):
        feed(system, [image], [stamp_s], check=False)
        if given.tasks:
            break
    return Scene(given.tasks[0], images, T_world_cam)


@cache
def blind_scene():
    """Six blank frames while the camera moves on."""
    images, _, T_world_cam = toy(110, 0, STEP_M)
    return _scene(blanked(images, BLIND), T_world_cam)


@cache
def faded_scene():
    """One second of very low contrast and fast motion: the views before and after do not overlap.

    These images have no ORB corners, and the motion before or after does not predict the camera's path.
    """
    images, _, T_world_cam = toy(185, 0, STEP_M)
    kept = np.cumsum([0] + [_FADED_SPEED if i in FADED else 1 for i in range(1, 120)])
    shown = [images[k] for k in kept]
    faded = [
        np.rint(120 + _FADED_CONTRAST * (image - 120.0)).astype(np.uint8) if i in FADED else image
        for i, image in enumerate(shown)
    ]
    return _scene(faded, T_world_cam[kept])


@cache
def smeared_scene():
    """Frames that each are the mean of 25 views while the camera moves on, between sharp ones."""
    images, _, T_world_cam = toy(140, 0, STEP_M)
    shown = [
        np.rint(np.mean(images[i - 12 : i + 13], axis=0)).astype(np.uint8) if i in SMEARED else image
        for i, image in enumerate(images[:120])
    ]
    return _scene(shown, T_world_cam[:120])


def _without_features(features):
    empty = {
        name: getattr(features, name)[:0] for name in ("xy_image", "xy", "octave", "angle_deg", "descriptors")
    }
    return replace(features, cell_start=np.zeros_like(features.cell_start), **empty)


def same_map(a, b):
    """Return True if two maps are the same, bit by bit."""
    arrays = zip(a.arrays, b.arrays, strict=True)
    return (a.n_keyframes, a.n_points) == (b.n_keyframes, b.n_points) and all(
        x.tobytes() == y.tobytes() for x, y in arrays
    )
