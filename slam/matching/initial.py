"""Matchers of initialisation, which match frames with a reference frame."""

from typing import Literal, Protocol

import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import FrameFeatures
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.matching._windowed_kernels import match_for_initialization
from dslab.slam.matching.gms import GmsConfig, match_gms

MatcherKind = Literal["windowed", "gms", "gms_alone"]


class InitialMatcher(Protocol):
    """Matches consecutive frames with one reference frame."""

    def start(self, reference: FrameFeatures) -> None:
        """Set a new reference frame."""
        ...

    def match(self, frame: FrameFeatures) -> np.ndarray:
        """Match the next frame with the reference frame.

        Returns:
            (K, 2) int rows (keypoint of the reference frame, keypoint of the frame), by the former; no
            keypoint occurs twice.

        Raises:
            RuntimeError: there is no reference frame yet.
        """
        ...


class WindowedMatcher:
    """Matches each keypoint near its last position: cheap, and sufficient for small motions.

    Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, section IV.
    """

    def __init__(self, view: ViewGeometry, radius_px: float, max_octave: int, ratio: float) -> None:
        """Store the settings, which are those of InitializationConfig."""
        self._view = view
        self._radius_px = radius_px
        self._max_octave = max_octave
        self._ratio = ratio
        self._reference: FrameFeatures | None = None
        self._around = np.empty((0, 2))

    def start(self, reference: FrameFeatures) -> None:
        """Set a new reference frame."""
        self._reference = reference
        self._around = reference.xy.copy()

    def match(self, frame: FrameFeatures) -> np.ndarray:
        """Match the next frame with the reference frame; see InitialMatcher."""
        a, b = _given(self._reference), frame
        matched, _ = match_for_initialization(
            a.xy, a.octave, a.angle_deg, a.descriptors, self._around, self._view,
            b.xy, b.octave, b.angle_deg, b.descriptors, b.cell_start,
            self._radius_px, self._max_octave, self._ratio,
        )  # fmt: skip
        rows = np.flatnonzero(matched >= 0)
        pairs = np.column_stack([rows, matched[rows]])
        self.follow(pairs, frame)
        return pairs

    def follow(self, pairs: np.ndarray, frame: FrameFeatures) -> None:
        """Move the windows of matched keypoints, (K, 2) as of ``match``, to their positions in a frame."""
        self._around[pairs[:, 0]] = frame.xy[pairs[:, 1]]


class GmsMatcher:
    """Matches keypoints near their last position, on every pyramid level, and all others by GMS.

    GMS matches keypoints after any motion, except those that move differently from their neighbours: those
    of near points, which have the most parallax. These are matched near their last position.

    Source: GMS for initialisation: Huang et al., "Dual-SLAM", 2020, section III-D.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        view: ViewGeometry,
        radius_px: float,
        ratio: float,
        config: GmsConfig,
        alone: bool = False,
    ) -> None:
        """Store the settings, which are those of InitializationConfig; ``alone``: match by GMS only."""
        self._alone = alone
        self._near = WindowedMatcher(view, radius_px, config.max_octave, ratio)
        self._size_px = (camera.width_px, camera.height_px)
        self._config = config
        self._reference: FrameFeatures | None = None

    def start(self, reference: FrameFeatures) -> None:
        """Set a new reference frame."""
        self._reference = reference
        self._near.start(reference)

    def match(self, frame: FrameFeatures) -> np.ndarray:
        """Match the next frame with the reference frame; see InitialMatcher."""
        reference = _given(self._reference)
        if self._alone:
            return match_gms(reference, frame, self._size_px, self._config)
        near = self._near.match(frame)
        far = match_gms(reference, frame, self._size_px, self._config)
        far = far[~np.isin(far[:, 0], near[:, 0]) & ~np.isin(far[:, 1], near[:, 1])]
        self._near.follow(far, frame)
        pairs = np.concatenate([near, far])
        return pairs[np.argsort(pairs[:, 0])]


def _given(reference: FrameFeatures | None) -> FrameFeatures:
    if reference is None:
        raise RuntimeError("no reference frame")
    return reference
