"""Colours that stand beside each other are told apart, also by those who see two primary colours only."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from dslab.experiments.pictures import palette
from dslab.experiments.recording import palette as recording

# Machado, Oliveira, Fernandes 2009, severity 1, of linear RGB: all colours, then no red, green or blue cones.
SEEN = np.array(
    [
        np.eye(3),
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    ]
)
# Linear RGB to XYZ over the white point of sRGB.
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
TO_XYZ /= np.array([[0.9505], [1.0], [1.089]])


def seen(colour):
    """(4, 3) CIELAB of a colour, as SEEN."""
    rgb = np.array(to_rgb(colour) if isinstance(colour, str) else np.array(colour) / 255)
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(SEEN @ linear, 0, 1) @ TO_XYZ.T
    x, y, z = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116).T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def least_difference(one, other):
    return float(np.linalg.norm(seen(one) - seen(other), axis=1).min())


@pytest.mark.parametrize("other", ["base", "dual+", "paper", "dso", "motion_blur", "fast_rotation"])
def test_dual_slam_is_told_from_what_stands_beside_it(other):
    """By 20 of CIELAB's units at least; 2 are just noticeable."""
    segments = palette.segment_colors(["motion_blur", "fast_rotation"])
    colour = segments.get(other) or palette.system_color(other, 0)
    assert least_difference(palette.system_color("dual", 1), colour) > 20


def test_the_first_systems_of_a_recording_are_told_from_its_stress():
    base, dual = recording.system_color(0), recording.system_color(1)
    assert min(least_difference(one, recording.INJECTED) for one in (base, dual)) > 20
    assert least_difference(base, dual) > 20
