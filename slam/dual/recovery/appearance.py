"""Photometric check of an alignment: does the old map's surface look like the new map's frames?

The patches about the old map's points, as its keyframes near the meeting show them, are carried into the new
map's frames there by the similarity that was found. Under a right one most of them are seen where they should
be; under a wrong one no more than by chance.
"""

import numpy as np

from dslab.slam.core.settings import setting, settings
from dslab.slam.direct.appearance import Appearance, Surface, compare, pooled
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.dual.recovery.interface import RecoveryTask
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_decompose


@settings
class LooksConfig:
    """What the old map's surface must look like in the new map's frames."""

    views: int = setting(5, "keyframes of either map compared: the aligned one, the most covisible")
    points: int = setting(100, "most points of a keyframe whose patches are compared")
    least_correlation: float = setting(0.7, "correlation from which a patch looks alike", le=1)
    min_told: int = setting(30, "telling patches in view, below which two views say nothing")
    min_excess: float = setting(0.5, "share of patches that must look alike beyond chance", le=1)
    min_sound: float = setting(1.0, "share of the new map's views that must show it; 0 for no check", le=1)


class LooksCheck:
    """Compares the surfaces of old maps with views of the new map.

    Args:
        task: of the recovery; its buffered images are looked at.
        rectifier: of the camera.
        config: settings.
    """

    def __init__(self, task: RecoveryTask, rectifier: Rectifier, config: LooksConfig) -> None:
        self._task = task
        self._rectifier = rectifier
        self._config = config
        self._held = {features.index for features in task.backward} | {task.first.features.index}
        self._pyramids: dict[int, ImagePyramid] = {}

    def objection(self, old: Map, found: Alignment) -> str:
        """``images_differ`` if the surface does not look like the new frames; empty if it does.

        Empty too if too few patches tell anything: the features alone must decide.
        """
        if self._config.min_sound <= 0:
            return ""
        looks = [look for look in self.looks(old, found) if look.told >= self._config.min_told]
        sound = sum(look.excess >= self._config.min_excess for look in looks)
        return "images_differ" if sound < self._config.min_sound * len(looks) else ""

    def looks(self, old: Map, found: Alignment) -> list[Appearance]:
        """How the old map's surface looks in each view of the new map, the aligned keyframe first."""
        new, config = self._task.new_map, self._config
        scale, R, t = sim3_decompose(found.S_old_new)
        S_new_old = np.eye(4)  # in the old map's length unit
        S_new_old[:3, :3], S_new_old[:3, 3] = R.T, -R.T @ t
        old_views = [(k, self._surface(old, k)) for k in self._views(old, found.old_keyframe)]
        seen = []
        for k in self._views(new, found.new_keyframe):
            T_cam_new = new.T_cam_map(k)
            T_cam_new[:3, 3] *= scale
            pyramid = self._pyramid(new.frame_index(k))
            pairs = [
                compare(
                    surface, pyramid, self._rectifier.intrinsics,
                    T_cam_new @ S_new_old @ np.linalg.inv(old.T_cam_map(j)), config.least_correlation,
                )
                for j, surface in old_views
                if old.frame_index(j) != new.frame_index(k)
            ]  # fmt: skip
            seen.append(pooled(pairs))
        return seen

    def _views(self, m: Map, keyframe: int) -> list[int]:
        """Keyframes about one whose images are held, itself first."""
        about = [keyframe, *map(int, m.neighbours(keyframe, 4 * self._config.views))]
        return [k for k in about if m.frame_index(k) in self._held][: self._config.views]

    def _surface(self, m: Map, keyframe: int) -> Surface:
        """The points that a keyframe observes, as its image shows them."""
        point = m.observed_points(keyframe)
        rows = np.flatnonzero(point >= 0)
        count = min(self._config.points, len(rows))
        rows = rows[np.arange(count) * len(rows) // max(1, count)]
        T = m.T_cam_map(keyframe)
        depth = m.arrays.pt_xyz[point[rows]] @ T[2, :3] + T[2, 3]
        ahead = depth > 0
        xy = m.arrays.kp_xy[m.keypoints(keyframe)][rows[ahead]]
        return Surface(self._pyramid(m.frame_index(keyframe)), xy, 1 / depth[ahead])

    def _pyramid(self, index: int) -> ImagePyramid:
        if index not in self._pyramids:
            self._pyramids[index] = self._rectifier.pyramid(self._task.image_of(index))
        return self._pyramids[index]
