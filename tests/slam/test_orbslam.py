"""ORB-SLAM as published: each setting is published, idle or told to stay; its rules are its text's."""

from dataclasses import is_dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from slam_scenes import blanked, feed, kinds, toy

from dslab.slam.dual import paper
from dslab.slam.dual.recovery.paper import paper_orb_config, paper_sift_config
from dslab.slam.factory import build_system, default_settings
from dslab.slam.initialization.published import published_reconstruction
from dslab.slam.orbslam import NO_EFFECT, PUBLISHED, STAYS, names_of, orbslam_config
from dslab.slam.toy_sequence import CAMERA
from dslab.slam.tracking.rules.published import PublishedKeyframeChoice, PublishedLoss


def value_of(config, name):
    for part in name.split("."):
        config = getattr(config, part)
    return config


def within(name, groups):
    return any(name == group or name.startswith(group + ".") for group in groups)


def classified(names, said, unread, stays):
    """Where each name belongs; names of tables that no setting has."""
    of = {n: [t for t, table in (("said", said), ("stays", stays)) if n in table] for n in names}
    for name, found in of.items():
        if not found and within(name, unread):
            found.append("no effect")
    known = set(names) | {".".join(n.split(".")[:i]) for n in names for i in range(1, 9)}
    return of, (set(said) | set(stays) | set(unread)) - known


def test_every_setting_of_orbslam_is_published_or_idle_or_told_to_stay():
    config = orbslam_config(CAMERA)
    of, unknown = classified(names_of(config), PUBLISHED, NO_EFFECT, STAYS)
    assert {n: found for n, found in of.items() if len(found) != 1} == {} and not unknown
    assert {n for n, p in PUBLISHED.items() if value_of(config, n) != p.value} == set()
    assert set(NO_EFFECT.values()) <= set(PUBLISHED)


def test_every_setting_of_the_papers_dual_slam_is_said_or_idle_or_told_to_stay():
    names = set(names_of(paper.PAPER))
    orb, sift = names_of(paper_orb_config()), names_of(paper_sift_config())
    names |= {f"THREAD.{n}" for n in set(orb) & set(sift)}
    names |= {f"ORB.{n}" for n in set(orb) - set(sift)} | {f"SIFT.{n}" for n in set(sift) - set(orb)}
    said = set(paper.SAID) - {"THREAD.doubt"}
    of, unknown = classified(names, said, {*paper.NO_EFFECT, "THREAD.doubt"}, paper.STAYS)
    assert {n: found for n, found in of.items() if len(found) != 1} == {} and not unknown


def test_settings_that_are_said_to_have_no_effect_are_not_read(monkeypatch):
    """A run with a start, a loss and a return reads none, but those that a bound of 0 idles."""
    read = set()

    def watch(config, path):
        for name in type(config).__dataclass_fields__:
            value = getattr(config, name)
            if is_dataclass(value):
                watch(value, f"{path}{name}.")
        by_name[id(config)] = path

    by_name: dict[int, str] = {}
    config, _ = default_settings("orbslam", CAMERA)
    images, stamps_s, _ = toy(130, 0, 0.05)
    system = build_system("orbslam", CAMERA, 0, config)
    watch(config, "")
    names = set(names_of(config))
    for group in {type(value_of(config, p.rstrip("."))) if p else type(config) for p in by_name.values()}:

        def reading(self, name, get=object.__getattribute__):
            path = by_name.get(id(self))
            if path is not None and not name.startswith("_"):
                read.add(path + name)
            return get(self, name)

        monkeypatch.setattr(group, "__getattribute__", reading)
    feed(system, blanked(images, range(100, 104)), stamps_s)
    monkeypatch.undo()
    assert {"initialized", "breakage", "relocalized"} <= set(kinds(system))
    leaves = read & names
    assert len(leaves) > 30
    idle = [group for group, switch in NO_EFFECT.items() if PUBLISHED[switch].value != 0.0]
    assert {n for n in leaves if n not in PUBLISHED and within(n, idle)} == set()


def test_the_rules_of_the_text_say_when_a_frame_is_lost_and_when_it_is_a_keyframe(monkeypatch):
    class Features:
        def __init__(self, index):
            self.index, self.stamp_s = index, index / 30

    class Frame:
        def __init__(self, index):
            self.features, self.reference_keyframe = Features(index), 0

    class Tracking:
        map, resumed = SimpleNamespace(arrays=None, n_keyframes=3), None
        last_keyframe = Features(100)

    from dslab.slam.tracking.rules import published

    monkeypatch.setattr(published, "count_observed", lambda _, __, least: {1: 100, 3: 50}[least])
    choice, loss, state = PublishedKeyframeChoice(), PublishedLoss(), Tracking()
    wants = lambda index, inliers, idle: choice.wants(state, Frame(index), inliers, idle)  # noqa: E731
    assert wants(112, 89, True) and not wants(112, 90, True) and not wants(112, 49, True)
    assert not wants(111, 89, True)  # mapping is busy for .384 s
    assert not wants(120, 89, False) and wants(121, 89, False)
    state.map.n_keyframes = 2
    assert wants(101, 89, True)
    lost = lambda index, inliers: loss.fault(state, Frame(index), None, inliers)  # noqa: E731
    assert lost(101, 29) and not lost(101, 30)
    state.resumed = Features(100)
    assert lost(129, 49) and not lost(129, 50) and not lost(130, 30)
    assert not wants(120, 89, True) and wants(121, 89, True)


@pytest.mark.parametrize("flat", [False, True])
def test_two_views_are_reconstructed_by_the_model_that_explains_them(flat):
    rng = np.random.default_rng(3)
    depth = rng.uniform(4, 8, 300)
    xy = rng.uniform(-0.5, 0.5, (300, 2))
    if flat:
        depth = 5 / (1 - 0.4 * xy[:, 0])
    points = np.column_stack([xy * depth[:, None], depth])
    T = np.eye(4)
    T[:3, 3] = (1.0, 0.1, 0.2)
    K = CAMERA.K
    seen = [p / p[:, 2:] @ K.T for p in (points, points + T[:3, 3])]
    pixels = [s[:, :2] + rng.normal(0, 0.3, (300, 2)) for s in seen]
    found = published_reconstruction(*pixels, K, np.random.default_rng(0))
    if flat:  # both motions of a plane put its points in front of the cameras
        assert (found.success, found.model, found.reason) == (False, "homography", "ambiguous")
        return
    assert found.success and found.model == "essential"
    t = T[:3, 3] / np.linalg.norm(T[:3, 3])
    assert found.T_2_1[:3, 3] @ t > np.cos(np.deg2rad(3))
    keep = found.triangulated
    assert np.median(np.abs(found.points[keep, 2] * np.linalg.norm(T[:3, 3]) / depth[keep] - 1)) < 0.1
    turned = published_reconstruction(pixels[0], pixels[0] + rng.normal(0, 0.3, (300, 2)), K, rng)
    assert not turned.success, "without a baseline there is no winner, or no parallax"
