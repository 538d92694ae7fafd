"""Single points located in a view whose motion is known, and alignment through motion blur."""

import numpy as np
from test_direct_alignment import RECTIFIER, TEXTURE, motion, plane_depth, reference, view  # noqa: F401

from dslab.slam.direct.alignment import Reference, align
from dslab.slam.direct.blur import align_through_blur
from dslab.slam.direct.location import locate_on_lines, locate_points
from dslab.slam.direct.selection import select

TURN = motion([0.15, 0.03, -0.05, 0.01, -0.03, 0.02])


def projected(xy, T):
    """Where points of the plane, seen at ``xy`` by the reference, are seen after the motion."""
    depth, _ = plane_depth(np.eye(4))
    z = depth[xy[:, 1], xy[:, 0]]
    X = np.column_stack([(xy - [159.5, 119.5]) / 250 * z[:, None], z]) @ T[:3, :3].T + T[:3, 3]
    return X[:, :2] / X[:, 2:] * 250 + [159.5, 119.5]


def scene():
    image, depth = view(np.eye(4))
    source = RECTIFIER.pyramid(image)
    xy = select(source).xy
    return source, xy, depth[xy[:, 1], xy[:, 0]], RECTIFIER.pyramid(view(TURN)[0])


def test_points_of_wrong_depth_are_shifted_to_where_they_are_seen():
    source, xy, depth, target = scene()
    exact = Reference(source, RECTIFIER.intrinsics, xy, 1 / depth)
    found = align(exact, target, [np.eye(4)])
    off = Reference(source, RECTIFIER.intrinsics, xy, 1 / (1.03 * depth))
    at, error = locate_points(off, target, found)
    seen = np.isfinite(at[:, 0]) & (error < 6)
    assert seen.mean() > 0.6
    wrong = np.linalg.norm(at - projected(xy, TURN), axis=1)[seen]
    assert np.median(wrong) < 0.15 and np.quantile(wrong, 0.9) < 1.0


def test_points_of_unknown_depth_are_found_on_their_lines():
    source, xy, depth, target = scene()
    found = align(Reference(source, RECTIFIER.intrinsics, xy, 1 / depth), target, [np.eye(4)])
    at = locate_on_lines(
        source, target, RECTIFIER.intrinsics[0], xy, found, float(np.median(depth)), 80.0, 8.0, 1.6
    )
    seen = np.isfinite(at[:, 0])
    assert seen.mean() > 0.2
    wrong = np.linalg.norm(at - projected(xy, TURN), axis=1)[seen]
    assert np.median(wrong) < 0.3 and (wrong < 1.5).mean() > 0.9


def smear(T_end, T_start):
    """Mean of views along a straight motion."""
    shares = np.linspace(0, 1, 25)
    images = [view(motion((1 - s) * np.asarray(T_start) + s * np.asarray(T_end)))[0] for s in shares]
    return np.rint(np.mean(images, axis=0)).astype(np.uint8)


def test_a_sharp_view_is_aligned_with_a_smeared_one_either_way():
    source, xy, depth, _ = scene()
    step = np.array([0.06, 0, 0, 0, 0, 0])
    middle = 1.5 * step
    smeared = RECTIFIER.pyramid(smear(middle + 2.5 * step, middle - 2.5 * step))
    sharp = Reference(source, RECTIFIER.intrinsics, xy, 1 / depth)
    points = np.column_stack([(xy - [159.5, 119.5]) / 250 * depth[:, None], depth])
    guess = [motion(middle + 0.5 * step)]
    plain = align(sharp, smeared, guess)
    found = align_through_blur(sharp, source, smeared, RECTIFIER, points, motion(step), guess)
    assert found is not None and plain is not None
    assert found.error < 0.6 * plain.error
    assert np.abs(found.T_target_ref[:3, 3] - middle[:3]).max() < 0.03
    image, deep = smear(2.5 * step, -2.5 * step), plane_depth(np.eye(4))[0]
    from_smear = RECTIFIER.pyramid(image)
    rows = select(from_smear).xy
    z = deep[rows[:, 1], rows[:, 0]]
    blurred = Reference(from_smear, RECTIFIER.intrinsics, rows, 1 / z)
    points = np.column_stack([(rows - [159.5, 119.5]) / 250 * z[:, None], z])
    target = RECTIFIER.pyramid(view(motion(middle))[0])
    back = align_through_blur(blurred, from_smear, target, RECTIFIER, points, motion(step), guess)
    assert back is not None and np.abs(back.T_target_ref[:3, 3] - middle[:3]).max() < 0.03


def test_without_motion_in_the_image_no_blur_is_tried():
    source, xy, depth, target = scene()
    ref = Reference(source, RECTIFIER.intrinsics, xy, 1 / depth)
    points = np.column_stack([(xy - [159.5, 119.5]) / 250 * depth[:, None], depth])
    assert align_through_blur(ref, source, target, RECTIFIER, points, np.eye(4), [np.eye(4)]) is None
