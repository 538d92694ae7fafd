"""A frame: its features, pose and matches with the map."""

from dataclasses import dataclass, field, replace

import numpy as np

from dslab.slam.core._frame_kernels import motion_between, sort_into_cells
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.core.results import RelativePose
from dslab.slam.core.snapshot import Immutable


@dataclass(frozen=True)
class Features:
    """Features of one image, N rows each, contiguous; octave by octave, the finest first.

    Attributes:
        xy: (N, 2) float32 pixels of the input image (distorted), integer = pixel centre.
        octave: (N,) int32 level of the pyramid.
        angle_deg: (N,) float32 in [0, 360), from the x axis towards the y axis.
        response: (N,) float32 contrast of the corner in grey levels.
        descriptors: (N, 4) uint64.
    """

    xy: np.ndarray
    octave: np.ndarray
    angle_deg: np.ndarray
    response: np.ndarray
    descriptors: np.ndarray

    def __len__(self) -> int:
        return len(self.xy)


@dataclass(frozen=True)
class FrameFeatures(Immutable):
    """The features of one image, ordered by grid cell; never changed after construction.

    Attributes:
        index: frame number, from 0.
        stamp_s: time stamp.
        xy_image: (N, 2) float32 keypoints in the input image, px.
        xy: (N, 2) float64 undistorted keypoints, px.
        octave: (N,) int32 pyramid level.
        angle_deg: (N,) float32 orientation.
        descriptors: (N, 4) uint64 ORB descriptors.
        cell_start: (cols * rows + 1,) int32, first keypoint of each grid cell, row-major.
        camera: by which ``xy`` are undistorted.
        twist: (6,) how the scene moves past the camera, by which ``xy`` are those of the middle row's time,
            see :meth:`slam.core.camera.PinholeCamera.ideal_points`.
        noise2: variance of the keypoints over what the view says, NaN where the frame has not told it.
    """

    index: int
    stamp_s: float
    xy_image: np.ndarray
    xy: np.ndarray
    octave: np.ndarray
    angle_deg: np.ndarray
    descriptors: np.ndarray
    cell_start: np.ndarray
    camera: PinholeCamera
    twist: np.ndarray = field(default_factory=lambda: np.zeros(6))
    noise2: float = np.nan

    def __len__(self) -> int:
        return len(self.octave)

    @property
    def nbytes(self) -> int:
        """Size of the arrays in bytes."""
        arrays = (self.xy_image, self.xy, self.octave, self.angle_deg, self.descriptors, self.cell_start)
        return sum(a.nbytes for a in arrays)

    def seen_by(self, camera: PinholeCamera) -> "FrameFeatures":
        """Return the same features undistorted with another camera; cells and order stay as they are."""
        return replace(self, xy=camera.ideal_points(self.xy_image, self.twist), camera=camera)

    def moving(self, twist: np.ndarray) -> "FrameFeatures":
        """Return the same features of a camera that moves otherwise; with a global shutter ``xy`` stay."""
        if not self.camera.readout_s:
            return replace(self, twist=twist)
        xy = self.camera.ideal_points(self.xy_image, twist)
        return replace(self, xy=xy, twist=twist)

    def emptied(self) -> "FrameFeatures":
        """Index and time stamp of the frame, without its features."""
        return FrameFeatures(
            self.index,
            self.stamp_s,
            self.xy_image[:0].copy(),
            self.xy[:0].copy(),
            self.octave[:0].copy(),
            self.angle_deg[:0].copy(),
            self.descriptors[:0].copy(),
            self.cell_start[:0].copy(),
            self.camera,
        )

    @staticmethod
    def build(
        index: int,
        stamp_s: float,
        features: Features,
        camera: PinholeCamera,
        view: ViewGeometry,
        twist: np.ndarray | None = None,
    ) -> "FrameFeatures":
        """Undistort extracted features and order them by grid cell."""
        twist = np.zeros(6) if twist is None else twist
        xy = camera.ideal_points(features.xy, twist)
        order, cell_start = sort_into_cells(xy, view)
        return FrameFeatures(
            index,
            stamp_s,
            features.xy[order],
            xy[order],
            features.octave[order],
            features.angle_deg[order],
            features.descriptors[order],
            cell_start,
            camera,
            twist,
        )


def twist_between(before: "Frame", after: "Frame", depth: float) -> np.ndarray:
    """(6,) how the scene moves past the camera between two frames with poses.

    Args:
        before, after: the frames.
        depth: median depth of what is seen.

    Returns:
        Velocity over the depth, 1/s, and angular velocity, rad/s, in the camera's frame.
    """
    motion = motion_between(*(np.ascontiguousarray(f.T_cam_map, np.float64) for f in (before, after)))
    motion[:3] /= depth
    return motion / (after.features.stamp_s - before.features.stamp_s)


@dataclass
class Frame:
    """One frame under tracking.

    Attributes:
        features: its features.
        point: (N,) int32 map point matched to each keypoint, -1 for none.
        T_cam_map: (4, 4) pose, NaN while unknown.
        reference_keyframe: the keyframe that shares most map points, -1 while unknown.
        T_cam_reference: (4, 4) pose relative to that keyframe, NaN while unknown.
        noise: standard deviation of its matched keypoints over the usual one, at least 1.
        noise2: variance of them over what the view says, NaN while unknown.
        covariance: (6, 6) of the pose from the points, as a twist from the left; infinite where it is not
            determined.
        relative: the pose relative to the reference keyframe with its covariance, None where not told.
        drawn: by how many standard deviations the pose moves without the cell of the image that tells most.
        cells: of the image in which points are found.
        depth: median one of what is found, map units; NaN while nothing is.
        evidence: log of the odds that the view is here, by all points that it should show.
        sought: pose (4, 4) and covariance (6, 6) by which points were last sought, None where not by those.
        area: (N,) of the window in which each keypoint was found, px²; 0 for the whole image.
    """

    features: FrameFeatures
    point: np.ndarray = field(init=False)
    T_cam_map: np.ndarray = field(default_factory=lambda: np.full((4, 4), np.nan))
    reference_keyframe: int = -1
    T_cam_reference: np.ndarray = field(default_factory=lambda: np.full((4, 4), np.nan))
    noise: float = 1.0
    noise2: float = np.nan
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))
    drawn: float = 0.0
    cells: int = 0
    depth: float = np.nan
    evidence: float = 0.0
    relative: RelativePose | None = None
    sought: tuple[np.ndarray, np.ndarray] | None = None
    area: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.point = np.full(len(self.features), -1, np.int32)
        self.area = np.zeros(len(self.features))

    def copy(self) -> "Frame":
        """Return an independent copy; the features, which never change, are shared."""
        copied = Frame(
            self.features,
            self.T_cam_map.copy(),
            self.reference_keyframe,
            self.T_cam_reference.copy(),
            self.noise,
            self.noise2,
            self.covariance.copy(),
            self.drawn,
            self.cells,
            self.depth,
            self.evidence,
            self.relative,
            self.sought,
        )
        copied.point[:] = self.point
        copied.area = self.area.copy()
        return copied
