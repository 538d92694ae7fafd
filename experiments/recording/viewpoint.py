"""How the scene of a recording is looked at: from above one long side of the path, all of it in view."""

from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.scene import Scene, together

_FOV_Y_DEG = 55.0
"""Of rerun's 3D views."""
_BORDER = 1.08
"""Distance from which all is in view is lengthened by this."""


@dataclass(frozen=True)
class Viewpoint:
    """Directions and sizes of what is drawn.

    Attributes:
        up: (3,) unit vector.
        across: (3,) unit vector on the ground, across the path and away from the viewer.
        far: where the paths end in this direction.
        extent: of all paths, metres or map units; the unit of the sizes of symbols.
    """

    up: np.ndarray
    across: np.ndarray
    far: float
    extent: float

    @property
    def along(self) -> np.ndarray:
        """(3,) unit vector to the right on the screen."""
        return np.cross(self.across, self.up)

    def eye(self, points: np.ndarray, aspect: float) -> tuple[np.ndarray, np.ndarray]:
        """Position of the eye and the point that it looks at, so that all points are in view.

        Args:
            points: (n, 3) float64 in the world; none for the origin.
            aspect: width of the view over its height.
        """
        towards = (0.9 * self.up - 0.95 * self.across) / np.hypot(0.9, 0.95)
        axes = np.stack([self.along, np.cross(towards, self.along), towards])
        seen = (points if len(points) else np.zeros((1, 3))) @ axes.T
        centre = (seen.min(axis=0) + seen.max(axis=0)) / 2
        seen = seen - centre
        half = np.tan(np.radians(_FOV_Y_DEG / 2)) * np.array([aspect, 1.0])
        distance = max(float((np.abs(seen[:, :2]) / half + seen[:, 2:]).max()), 1e-3)
        target = centre @ axes
        return target + _BORDER * distance * towards, target


def viewpoint(scenes: Many[Scene]) -> Viewpoint:
    """The viewpoint on runs over one sequence: the longer side of the paths lies across the view."""
    scene = together(scenes)
    ground = np.eye(3)[scene.up == 0]
    paths = [path.T_map_cam for one in scenes for path in one.final.values()]
    truth = np.empty((0, 4, 4)) if scene.T_world_cam is None else scene.T_world_cam
    places = np.concatenate([truth[np.isfinite(truth).all(axis=(1, 2))], *paths])[:, :3, 3]
    spread = (places - places.mean(axis=0)) @ ground.T if len(places) else np.zeros((1, 2))
    across = np.linalg.eigh(spread.T @ spread)[1][:, 0] @ ground
    far = float((places @ across).max()) if len(places) else 0.0
    return Viewpoint(scene.up, across, far, scene.extent)
