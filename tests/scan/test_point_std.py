"""Points with deviations of their own: by hand, and among good and bad points."""

import numpy as np
import pytest

from tests.scan.clouds import cylinder
from ttus_opt.core.errors import InputError
from ttus_opt.scan.candidates import Candidates, collect
from ttus_opt.scan.contour_filter import ContourModel, associate, follow
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis


def test_association_weighs_by_each_deviation():
    """β_i ∝ exp(−v²/2S_i)/σ_i² by hand; the gate is each candidate's own."""
    sigma, P, d = np.array([0.001, 0.004]), 0.001**2, 0.15
    v = np.array([-0.001, 0.003])
    m = associate((d + v)[None], np.array([d]), np.array([P]), sigma[None])
    beta = np.exp(-(v**2) / (2 * (P + sigma**2))) / sigma**2
    beta /= beta.sum()
    assert m.y[0] - d == pytest.approx(beta @ v, rel=1e-9)
    assert m.variance[0] == pytest.approx((beta**2 * sigma**2).sum(), rel=1e-9)
    far = associate(np.array([[d + 0.01]]), np.array([d]), np.array([P]), np.c_[0.001])
    near = associate(np.array([[d + 0.01]]), np.array([d]), np.array([P]), np.c_[0.004])
    assert not far.seen[0] and near.seen[0]


def test_one_deviation_for_all_is_that_of_each():
    rng = np.random.default_rng(0)
    r = np.sort(0.15 + 0.003 * rng.standard_normal((50, 9)), axis=1)
    r[:10, 6:] = [0.190, 0.192, np.inf]  # a second surface
    predicted, P = np.full(50, 0.151), np.full(50, 0.01**2)
    one = associate(r, predicted, P, 0.003)
    each = associate(r, predicted, P, np.full(r.shape, 0.003))
    np.testing.assert_allclose(each.y, one.y, rtol=1e-12)
    np.testing.assert_allclose(each.variance, one.variance, rtol=1e-12)


def test_deviations_and_offsets_follow_their_points():
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.2, 0.2, (600, 3))
    std = rng.uniform(0.001, 0.01, 600)
    theta, z = np.arange(12) * (2 * np.pi / 12), np.linspace(-0.1, 0.1, 5)
    reach = {"spoke_distance": 0.02, "slice_distance": 0.03}
    found = collect(points, theta, z, std=std, n_most=4, **reach)
    r = np.hypot(points[:, 0], points[:, 1])
    for j, k, m in np.argwhere(np.isfinite(found.radius)):
        i = int(np.argmin(np.abs(r - found.radius[j, k, m])))
        assert found.std[j, k, m] == std[i]
        across = points[i, :2] @ [-np.sin(theta[j]), np.cos(theta[j])]
        off = np.hypot(across, points[i, 2] - z[k]) / r[i]
        assert found.offset[j, k, m] == pytest.approx(off, abs=1e-12)
    np.testing.assert_array_equal(
        found.radius, collect(points, theta, z, n_most=4, **reach).radius
    )


def test_slope_adds_to_a_points_own_deviation():
    """A candidate off its spoke weighs less: σ² + (slope_std · offset)²."""
    radius = np.tile(np.array([0.149, 0.151]), (36, 1, 1))
    std = np.full(radius.shape, 0.001)
    model = ContourModel(slope_std=0.1)

    def level(offset):
        offsets = np.zeros(radius.shape)
        offsets[..., 1] = offset
        given = Candidates(radius, np.full((36, 1), 2), std, offsets)
        return float(follow(given, model).radius.mean())

    assert level(0.0) == pytest.approx(0.150, abs=1e-5)
    weight = 1e-6 / (1e-6 + (0.1 * 0.03) ** 2)
    expected = 0.149 + 0.002 * weight / (1 + weight)
    assert level(0.03) == pytest.approx(expected, abs=1e-4)


def test_good_points_among_bad_ones_decide():
    """A scan of two cameras, one six times noisier: the answer is nearer the truth."""
    rng = np.random.default_rng(0)
    cloud = cylinder(rng, noise=0.0)[::2]
    std = np.where(rng.random(len(cloud)) < 0.7, 0.006, 0.001)
    outward = cloud * [1, 1, 0] / np.hypot(cloud[:, 0], cloud[:, 1])[:, None]
    truth = float(np.hypot(cloud[:, 0], cloud[:, 1]).mean())
    noisy = cloud + (std * rng.standard_normal(len(cloud)))[:, None] * outward
    size = {"axis": Axis.identity(), "support": None, "n_theta": 60, "n_z": 20}
    errors, uncertainties = [], []
    for deviations in (None, std):
        found = extract_surface(noisy, point_std=deviations, **size)
        errors.append(np.sqrt(np.mean((found.radius - truth) ** 2)))
        uncertainties.append(found.radius_std.mean())
    assert errors[1] < 0.7 * errors[0]
    assert (
        0.3 < errors[1] / uncertainties[1] < 1.2
    )  # a circle has less slope than assumed


@pytest.mark.parametrize(
    ("std", "words"),
    [
        (np.full(5, 0.001), "one standard deviation"),
        (np.full((20_000, 1), 0.001), "one standard deviation"),
        (np.full(20_000, 0.0), "between 0 and 0.1 m"),
        (np.full(20_000, np.nan), "between 0 and 0.1 m"),
        (np.full(20_000, 2.0), "give metres"),
    ],
)
def test_unusable_deviations(std, words):
    cloud = cylinder(np.random.default_rng(0))[:20_000]
    if len(std) == 20_000:
        std = np.resize(std, (len(cloud), *std.shape[1:]))
    with pytest.raises(InputError, match=words):
        extract_surface(cloud, axis=Axis.identity(), support=None, point_std=std)
