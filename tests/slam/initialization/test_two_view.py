"""Two views are reconstructed if they determine the motion, else refused with the right reason."""

import numpy as np
import pytest
from two_view_scenes import K, direction_error_deg, project, rigid, rotation_error_deg, scene

from dslab.slam.initialization._two_view_refinement import RefinedMotion
from dslab.slam.initialization.two_view import TwoViewConfig, _least_lead, two_view_reconstruction


def reconstruct(pixels_1, pixels_2, config=None, seed=1):
    return two_view_reconstruction(pixels_1, pixels_2, K, np.random.default_rng(seed), config)


@pytest.mark.parametrize("baseline", [0.2, 0.4])
@pytest.mark.parametrize(
    ("kind", "model", "least"),
    [
        ("general", "essential", 12),
        ("corner", None, 7),
        ("wall", "homography", 4),
        ("plane", "homography", 0),
    ],
)
def test_scenes_are_reconstructed_and_never_wrongly(kind, model, least, baseline):
    successes = 0
    for seed in range(12):
        T, points, u, v, wrong = scene(kind, seed, baseline=baseline)
        result = reconstruct(u, v)
        assert model is None or result.model == model
        if not result.success:
            assert result.reason in {"ambiguous", "ill_conditioned", "low_parallax"}
            continue
        successes += 1
        assert result.reason == ""
        assert rotation_error_deg(result.T_2_1, T) < 0.8
        assert direction_error_deg(result.T_2_1[:3, 3], T[:3, 3]) < 8.0
        assert np.linalg.norm(result.T_2_1[:3, 3]) == pytest.approx(1.0)
        found = result.triangulated
        assert found.sum() >= 100 and found[:wrong].mean() < 0.1
        np.testing.assert_array_equal(found, np.isfinite(result.points).all(axis=1))
        scale = (points[:, 2] / result.points[:, 2])[wrong:][found[wrong:]]
        assert np.median(np.abs(scale / np.median(scale) - 1)) < 0.1
        assert np.median(scale) == pytest.approx(baseline, rel=0.3)
        assert result.parallax_deg > 1.0
    assert successes >= least


def test_the_direction_uses_all_matches():
    """The motion fits all matches: its error is that expected from the noise."""
    errors = []
    for seed in range(10):
        T, _, u, v, _ = scene("general", seed)
        errors.append(direction_error_deg(reconstruct(u, v).T_2_1[:3, 3], T[:3, 3]))
    assert np.median(errors) < 0.7 and max(errors) < 2.0


def test_noisier_matches_have_less_weight():
    def errors(told):
        found = []
        for seed in range(8):
            T, _, u, v, _ = scene("general", seed, outliers=0.0, noise=0.3)
            scale = np.where(np.arange(len(u)) % 3 > 0, 6.0, 1.0)
            rng = np.random.default_rng(seed)
            u, v = (p + 0.3 * (scale[:, None] - 1) * rng.normal(size=p.shape) for p in (u, v))
            rng = np.random.default_rng(1)
            result = two_view_reconstruction(
                u, v, K, rng, TwoViewConfig(min_lead_sigmas=0.0), scale if told else None
            )
            found.append(direction_error_deg(result.T_2_1[:3, 3], T[:3, 3]))
        return np.median(found)

    assert errors(told=True) < 0.7 * errors(told=False)


@pytest.mark.parametrize("noise", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_pure_rotation_is_refused_for_its_parallax(seed, noise):
    _, _, u, v, _ = scene("rotation", seed, noise=noise)
    result = reconstruct(u, v)
    assert not result.success
    assert result.reason == "low_parallax"
    assert result.parallax_deg <= 0.01 + 0.6 * noise
    assert not result.triangulated.any() and np.isnan(result.points).all()


@pytest.mark.parametrize("seed", [2, 4, 5])
@pytest.mark.parametrize("turn_deg", [0.5, 0.6])
def test_a_small_rotation_of_rounded_keypoints_is_not_taken_for_a_translation(seed, turn_deg):
    """Rounding keeps most rows, as in a sideways motion."""
    rng, n = np.random.default_rng(seed), 2000
    scale = 1.2 ** rng.integers(0, 8, n)
    rays = np.column_stack([rng.uniform([20, 20], [620, 460], (n, 2)), np.ones(n)]) @ np.linalg.inv(K).T
    points = rays * rng.uniform(2, 8, (n, 1))
    turned = rigid([0.0, 0.0, 0.0], [0.0, np.deg2rad(turn_deg), 0.0])
    u, v = (
        np.round(project(T, points) / scale[:, None] + rng.normal(0, 0.1, (n, 2))) * scale[:, None]
        for T in (np.eye(4), turned)
    )
    config = TwoViewConfig(min_parallax_deg=0.6)
    result = two_view_reconstruction(u, v, K, np.random.default_rng(0), config, scale)
    assert (result.success, result.reason) == (False, "low_parallax")


def test_a_static_camera_is_refused_for_its_parallax():
    _, _, u, _, _ = scene("rotation", n=200)
    result = reconstruct(u, u.copy())
    assert (result.success, result.reason) == (False, "low_parallax")


def test_parallax_below_the_threshold_is_refused():
    T, _, u, v, _ = scene("general", baseline=0.2)
    result = reconstruct(u, v)
    assert result.success
    assert rotation_error_deg(result.T_2_1, T) < 1.0
    bound = result.parallax_deg + 0.1
    refused = reconstruct(u, v, TwoViewConfig(min_parallax_deg=bound))
    assert (refused.success, refused.reason) == (False, "low_parallax")
    assert refused.parallax_deg == result.parallax_deg


def test_a_plane_with_two_explanations_is_refused():
    """In motion towards a tilted plane, a second plane and motion explain the views as well."""
    _, points, u, _, _ = scene("plane", outliers=0.0)
    T = rigid([0.0, 0.0, -0.5], [0.0, 0.0, 0.0])
    v = project(T, points) + np.random.default_rng(0).normal(0, 0.3, u.shape)
    result = reconstruct(u, v)
    assert (result.model, result.success, result.reason) == ("homography", False, "ambiguous")
    assert reconstruct(u, v, TwoViewConfig(min_lead_sigmas=0.0)).success


def test_a_plane_with_points_in_front_has_one_explanation():
    """Structure outside the plane distinguishes its two motions."""
    T = rigid([0.0, 0.0, -0.5], [0.0, 0.0, 0.0])
    for share, reason in ((0.0, "ambiguous"), (0.3, "")):
        _, points, u, _, _ = scene("plane", outliers=0.0)
        before = np.arange(len(points)) < share * len(points)
        points = np.where(before[:, None], 0.6 * points, points)
        v = project(T, points) + np.random.default_rng(0).normal(0, 0.3, u.shape)
        result = reconstruct(u, v)
        assert result.reason == reason
    assert direction_error_deg(result.T_2_1[:3, 3], T[:3, 3]) < 2.0


def test_an_ill_conditioned_direction_is_refused():
    """With little parallax a sideways motion and a rotation look alike, more so with noise."""
    reasons = []
    for noise in (0.2, 1.5, 4.0):
        _, _, u, v, _ = scene("general", 3, outliers=0.0, baseline=0.3, noise=noise)
        config = TwoViewConfig(sigma_px=4.0, min_parallax_deg=0.0, min_points=20)
        reasons.append(reconstruct(u, v, config).reason)
    assert reasons[0] == ""
    assert reasons[-1] in {"ambiguous", "ill_conditioned"}


class TestRivals:
    CONFIG = TwoViewConfig(rival_angle_deg=20.0, min_lead_sigmas=3.5)

    def motion(self, angle_deg, costs):
        angle = np.deg2rad(angle_deg)
        T = rigid([np.cos(angle), np.sin(angle), 0.0], [0.0, 0.0, 0.0])
        return RefinedMotion(T, np.zeros((len(costs), 2)), np.asarray(costs, float), np.eye(5))

    def rivals(self, angle_deg, best, other):
        lead, _ = _least_lead(self.motion(0.0, best), [self.motion(angle_deg, other)], self.CONFIG)
        return lead < self.CONFIG.min_lead_sigmas

    def test_an_equally_good_motion_is_a_rival_unless_it_is_the_same(self):
        costs = np.random.default_rng(0).chisquare(1, 200)
        assert self.rivals(180.0, costs, costs)
        assert self.rivals(20.0, costs, costs)
        assert not self.rivals(19.0, costs, costs)

    def test_a_lead_of_a_few_matches_does_not_count(self):
        best = np.random.default_rng(1).chisquare(1, 200)
        for count, rival in ((3, True), (60, False)):
            other = best.copy()
            other[:count] = 7.3
            assert self.rivals(90.0, best, other) == rival

    def test_a_lead_must_exceed_its_scatter(self):
        rng = np.random.default_rng(2)
        best = np.full(400, 4.0)
        lead = rng.normal(0, 2, 400)
        lead -= lead.mean()
        for sigmas, rival in ((2.0, True), (5.0, False)):
            assert self.rivals(90.0, best, best + lead + sigmas * lead.std() / np.sqrt(400)) == rival

    def test_a_lead_far_below_the_noise_does_not_count(self):
        best = np.zeros(300)
        assert self.rivals(90.0, best, best + 1e-3)
        assert not self.rivals(90.0, best, best + 1.0)


@pytest.mark.parametrize("n", [0, 1, 7, 99])
def test_few_matches_are_refused(n):
    _, _, u, v, _ = scene("general")
    result = reconstruct(u[:n], v[:n])
    assert (result.success, result.reason, result.model) == (False, "too_few_matches", None)
    assert result.points.shape == (n, 3) and result.triangulated.shape == (n,)


def test_matches_without_a_geometry_are_refused():
    rng = np.random.default_rng(0)
    result = reconstruct(*(rng.uniform([0, 0], [640, 480], (200, 2)) for _ in range(2)))
    assert not result.success
    assert result.reason in {"no_model", "few_points", "ambiguous", "low_parallax"}


@pytest.mark.parametrize("spread", [0.0, 600.0])
@pytest.mark.parametrize("slope", [0.0, 0.5, -0.75])
@pytest.mark.parametrize("noise", [0.0, 0.2, 0.5])
def test_coincident_or_collinear_matches_are_refused(spread, slope, noise):
    rng = np.random.default_rng(0)
    x = 20 + spread * rng.random(150)
    u = np.column_stack([x, 50 + slope * x]) + rng.normal(0, noise, (150, 2))
    for shift in ((0.0, 0.0), (10.0, 0.0), (40.0, 0.0), (-25.0, 27.0)):
        v = u + shift + rng.normal(0, noise, (150, 2))
        assert not reconstruct(u, v).success


@pytest.mark.parametrize("seed", [2, 18, 26, 113, 152, 184])
def test_collinear_matches_are_refused_even_if_a_motion_fits(seed):
    """Large rotations that place the scene next to the camera; selected from many lines."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(100, 300))
    x = 20 + 600 * rng.random(n)
    y = 240 + rng.uniform(-1, 1) * (x - 320)
    u = np.column_stack([x, y]) + rng.normal(0, rng.choice([0, 0.2, 0.5, 1.0]), (n, 2))
    v = u + rng.uniform(-40, 40, 2)
    v += rng.normal(0, rng.choice([0, 0.2, 0.5]), (n, 2))
    assert not reconstruct(u, v).success


def test_points_are_kept_up_to_the_nominal_noise():
    T, _, u, v, _ = scene("general", outliers=0.0, noise=0.1)
    worse = np.arange(len(u)) % 4 == 0
    v[worse] += np.random.default_rng(0).uniform(-0.9, 0.9, (worse.sum(), 2))
    result = reconstruct(u, v)
    assert direction_error_deg(result.T_2_1[:3, 3], T[:3, 3]) < 1.0
    assert result.triangulated[worse].mean() > 0.9


def test_too_few_points_are_refused():
    _, _, u, v, _ = scene("general", n=120)
    assert reconstruct(u, v, TwoViewConfig(min_points=110)).reason == "few_points"


def test_the_same_seed_gives_the_same_bits():
    _, _, u, v, _ = scene("general", n=150)
    first, second = reconstruct(u, v, seed=5), reconstruct(u, v, seed=5)
    np.testing.assert_array_equal(first.T_2_1, second.T_2_1)
    np.testing.assert_array_equal(first.points, second.points)
    assert (first.score_h, first.score_e) == (second.score_h, second.score_e)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_invalid_matches_are_refused(bad):
    _, _, u, v, _ = scene("general")
    with pytest.raises(ValueError, match="pairs"):
        reconstruct(u, v[:-1])
    v[3, 0] = bad
    with pytest.raises(ValueError, match="finite"):
        reconstruct(u, v)


@pytest.mark.parametrize("scale", [np.ones(3), np.zeros(300), np.full(300, np.nan)])
def test_invalid_scales_are_refused(scale):
    _, _, u, v, _ = scene("general")
    with pytest.raises(ValueError, match="scale"):
        two_view_reconstruction(u, v, K, np.random.default_rng(0), None, scale)
