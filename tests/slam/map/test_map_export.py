"""Maps as COLMAP models: read back by pycolmap, they are unchanged."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from slam_scenes import CAMERA, feed, toy

from dslab.slam.factory import build_system
from dslab.slam.map.export import colmap_model, write_colmap
from dslab.slam.toy_sequence import CAMERA as TOY_CAMERA


@pytest.fixture(scope="module")
def mapped():
    images, stamps_s, _ = toy(60, step_m=0.05)
    system = build_system("base", TOY_CAMERA, 0)
    feed(system, images, stamps_s, check=False)
    return system.current_map, images


@pytest.fixture(scope="module")
def read_back(mapped, tmp_path_factory):
    folder = tmp_path_factory.mktemp("model") / "sparse"
    map_, images = mapped
    write_colmap(colmap_model(map_, TOY_CAMERA, image=lambda i: images[i]), folder)
    assert (folder / "points.ply").read_bytes().startswith(b"ply")
    return pycolmap.Reconstruction(folder)


def test_every_keyframe_point_and_observation_is_there(mapped, read_back):
    map_, _ = mapped
    assert read_back.num_reg_images() == len(map_.keyframes())
    assert read_back.num_points3D() == len(map_.points())
    assert read_back.compute_num_observations() == int((map_.arrays.kp_point >= 0).sum())
    for p, point in read_back.points3D.items():
        np.testing.assert_array_equal(point.xyz, map_.arrays.pt_xyz[p - 1])


def test_poses_names_and_keypoints(mapped, read_back):
    map_, _ = mapped
    for k in map_.keyframes():
        image = read_back.image(int(k) + 1)
        assert image.name == f"{map_.frame_index(int(k)):06d}.png"
        np.testing.assert_allclose(image.cam_from_world().matrix(), map_.T_cam_map(int(k))[:3], atol=1e-12)
        shown = np.array([p.point3D_id - 1 if p.has_point3D() else -1 for p in image.points2D])
        np.testing.assert_array_equal(shown, map_.observed_points(int(k)))


def test_the_reprojection_error_is_the_map_s(mapped, read_back):
    """A wrong half pixel between the conventions would change the errors."""
    map_, _ = mapped
    a = map_.arrays
    rows = np.flatnonzero(a.kp_point >= 0)
    T = a.kf_T_cam_map[a.kp_keyframe[rows]]
    xyz = np.einsum("nij,nj->ni", T[:, :3, :3], a.pt_xyz[a.kp_point[rows]]) + T[:, :3, 3]
    view = map_.view
    xy = xyz[:, :2] / xyz[:, 2:] * (view.fx, view.fy) + (view.cx, view.cy)
    error = np.linalg.norm(xy - a.kp_xy[rows], axis=1)
    per_point = np.bincount(a.kp_point[rows], error) / np.maximum(np.bincount(a.kp_point[rows]), 1)
    for p, point in read_back.points3D.items():
        assert point.error == pytest.approx(per_point[p - 1], abs=1e-3)


def test_points_take_the_grey_of_the_images(mapped, read_back):
    shades = np.array([point.color[0] for point in read_back.points3D.values()])
    assert shades.std() > 10
    map_, _ = mapped
    plain = colmap_model(map_, TOY_CAMERA)
    assert {int(point.color[0]) for point in plain.points3D.values()} == {128}


@pytest.mark.parametrize(
    ("lens", "model"),
    [
        ({}, "PINHOLE"),
        ({"distortion": (-0.28, 0.07, 2e-4, 2e-5, 0.0)}, "OPENCV"),
        ({"distortion": (-0.28, 0.07, 2e-4, 2e-5, 0.01)}, "FULL_OPENCV"),
        ({"distortion": (0.01, -0.002, 0.0, 0.0), "model": "equidistant"}, "OPENCV_FISHEYE"),
    ],
)
def test_the_exported_lens_projects_as_ours(mapped, lens, model):
    """Undistorting a pixel with our camera and projecting it with COLMAP's gives the pixel back."""
    camera = replace(CAMERA, **lens)
    theirs = colmap_model(mapped[0], camera).camera(1)
    assert theirs.model.name == model
    xy = np.random.default_rng(0).uniform((60, 60), (580, 420), (50, 2)).astype(np.float32)
    rays = (camera.undistort_points(xy) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    again = theirs.img_from_cam(np.column_stack([rays, np.ones(50)]))
    np.testing.assert_allclose(again - 0.5, xy, atol=2e-3)
