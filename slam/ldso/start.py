"""Start of a map: two views placed by features, or by intensities where there are none, then their pixels.

The frames between the two views are tracked by intensities from the first one, so that the depths of its
pixels are narrowed over growing baselines.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.geometry import ViewGeometry, share_of_motion, view_geometry
from dslab.slam.core.seeds import rng_for
from dslab.slam.direct.pyramid import ImagePyramid
from dslab.slam.features.finder import FeatureFinder
from dslab.slam.initialization.initializer import Initializer, InitialMap
from dslab.slam.ldso.brightness import composed
from dslab.slam.ldso.config import DsoConfig
from dslab.slam.ldso.first_depths import IntensityStart
from dslab.slam.ldso.odometry import Odometry
from dslab.slam.ldso.tracking import SURE, PhotometricTracker, TrackingReference
from dslab.slam.ldso.window import Keyframe

_PATCH = np.stack(np.meshgrid(np.arange(-1.0, 2.0), np.arange(-1.0, 2.0)), axis=-1).reshape(-1, 2)
_LEAST_POINTS = 150
_WITHOUT_FEATURES = {"too_few_keypoints", "too_few_matches"}
_MOST_ERROR = 12.0  # of a frame between the two views, of 255


@dataclass(frozen=True)
class Waiting:
    """A frame since the first view.

    Attributes:
        frame: its index.
        stamp_s: its time.
        image: (H, W) uint8.
        exposure: logarithm of its exposure over that of the first image; 0 where exposures are not known.
    """

    frame: int
    stamp_s: float
    image: np.ndarray
    exposure: float = 0.0


@dataclass(frozen=True)
class Started:
    """Outcome of a frame offered for a start.

    Attributes:
        odometry: the map, if one has begun.
        reason: why not.
        matches: with the first view.
        model: geometry that explained the two views.
    """

    odometry: Odometry | None
    reason: str
    matches: int
    model: str = ""


class Starter:
    """Seeks two views from which a map can start.

    Args:
        camera: of the images.
        intrinsics: (L, 4) of the levels of their pyramids.
        pyramid_of: makes the pyramid of an image.
        seed: root of the random streams.
        config: settings of the two views.
        dso: settings of what follows.
        view: of the corners by which places are recognised; None without loops.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        intrinsics: np.ndarray,
        pyramid_of: Callable[[np.ndarray], ImagePyramid],
        seed: int,
        config: SlamConfig,
        dso: DsoConfig,
        view: ViewGeometry | None = None,
    ) -> None:
        self.config = dso
        self._camera, self._intrinsics, self._pyramid_of, self._seed = camera, intrinsics, pyramid_of, seed
        self._mapping, self._corner_view = config.mapping, view
        orb = config.orb
        self._view = view_geometry(camera, orb.n_levels, orb.scale_factor, orb.noise_px)
        self._finder = FeatureFinder(camera, orb, config.initial_features)
        self._initializer = Initializer(camera, self._view, config.initialization)
        self._waiting: deque[Waiting] = deque(maxlen=config.initialization.max_between)
        self._intensities = IntensityStart(camera, intrinsics, dso)

    def reset(self) -> None:
        """Forget the first view."""
        self._initializer.reset()
        self._intensities.reset()
        self._waiting.clear()

    def offer(self, item: Waiting, map_id: int) -> Started:
        """Try to start a map with this frame as its second view.

        Args:
            item: the frame; its image is not changed any more.
            map_id: id of the map.
        """
        frame = item.frame
        features = self._finder.find(item.image, dense=True)
        built = FrameFeatures.build(frame, item.stamp_s, features, self._camera, self._view)
        rng = rng_for(self._seed, "initialization", frame)
        initial, reason, matches = self._initializer.offer(Frame(built), map_id, rng, self._mapping)
        self._waiting.append(item)
        if reason in _WITHOUT_FEATURES:
            return self._offer_intensities(item, reason, matches)
        self._intensities.reset()
        if initial is None:
            return Started(None, reason, matches)
        first, second = initial.first.features.index, initial.second.features.index
        motion = initial.second.T_cam_map @ np.linalg.inv(initial.first.T_cam_map)
        odometry = self._begin(first, second, motion, *_depths_of(initial))
        self.reset()
        if odometry is None:
            return Started(None, "images_do_not_fit", matches)
        return Started(odometry, "", matches, initial.model)

    def _offer_intensities(self, item: Waiting, reason: str, matches: int) -> Started:
        """Try to start without features, of which there are too few."""
        found = self._intensities.offer(item.frame, self._pyramid_of(item.image))
        if found is None:
            return Started(None, reason, matches)
        motion = found.T_second_first
        odometry = self._begin(found.first, found.second, motion, found.uv, found.inverse_depth)
        if odometry is None:
            return Started(None, "images_do_not_fit", matches)
        self.reset()
        return Started(odometry, "", len(found.uv), "intensities")

    def _begin(
        self, first: int, second: int, motion: np.ndarray, uv: np.ndarray, inverse_depth: np.ndarray
    ) -> Odometry | None:
        """Map of two views; None if the images do not fit to it.

        Args:
            first, second: indices of the frames.
            motion: (4, 4) first to second.
            uv, inverse_depth: (N, 2) pixels of the first, and (N,).
        """
        waiting = [w for w in self._waiting if w.frame >= first]
        if not waiting or waiting[0].frame != first:
            return None
        config = self.config
        odometry = Odometry(self._camera, self._intrinsics, config, self._corner_view)
        pyramid = self._pyramid_of(waiting[0].image)
        pixels = (uv[:, None] + _PATCH).reshape(-1, 2)
        depths = np.repeat(inverse_depth, len(_PATCH))
        reference = TrackingReference(pyramid, self._intrinsics, pixels, depths, np.ones(len(pixels)))
        exposure = waiting[0].exposure
        keyframe = Keyframe(first, waiting[0].stamp_s, np.eye(4), image=waiting[0].image, exposure=exposure)
        odometry.insert(keyframe, pyramid, np.array([exposure, 0.0]))
        w = odometry.window
        odometry.select(pyramid, 1.0 / reference.depth)
        tracker = PhotometricTracker(config.photometric, config.tracking)
        T, step, affine = np.eye(4), share_of_motion(motion, 1 / (second - first)), np.zeros(2)
        last = exposure
        for item in waiting[1:]:
            pyramid = self._pyramid_of(item.image)
            share = share_of_motion(motion, (item.frame - first) / (second - first))
            guesses = [step @ T, share, T] if item.frame < second else [motion, step @ T]
            affine = affine + np.array([item.exposure - last, 0.0])
            last = item.exposure
            found = tracker.track(reference, pyramid, guesses, affine, SURE, last - exposure)
            if found is None or found.error > _MOST_ERROR:
                return None
            step = found.T_frame_ref @ np.linalg.inv(T)
            T, affine = found.T_frame_ref, found.affine
            odometry.place(item.frame, item.stamp_s, T)
            odometry.search(pyramid, T, composed(affine, w.affine[w.newest]), found.error)
        keyframe = Keyframe(second, waiting[-1].stamp_s, T, image=waiting[-1].image, exposure=last)
        odometry.insert(keyframe, pyramid, composed(affine, w.affine[w.newest]))
        odometry.activate()
        if len(w.active) < _LEAST_POINTS:
            return None
        odometry.refer(pyramid)
        odometry.begin_motion()
        odometry.select(pyramid, 1.0 / odometry.depth)
        return odometry


def _depths_of(initial: InitialMap) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) pixels of the first view's map points, and their (N,) inverse depths."""
    m, T = initial.map, initial.first.T_cam_map
    rows = np.flatnonzero(m.observed_points(0) >= 0)
    depth = (m.arrays.pt_xyz[m.observed_points(0)[rows]] @ T[:3, :3].T + T[:3, 3])[:, 2]
    return initial.first.features.xy[rows], 1.0 / np.maximum(depth, 1e-6)
