"""Arms beside a simulated trunk: an ellipse and two cylinders with a gap between."""

import numpy as np
import pytest

from ttus_opt.core.errors import TtusWarning
from ttus_opt.scan.candidates import usable_range
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.limbs import trunk

AXIS = Axis(np.zeros(3), np.eye(3))
HALF = 0.17, 0.11  # trunk's semi-axes [m]


def column(a, b, x=0.0, angles=(0.0, 2 * np.pi), n=160):
    """Points of an elliptic column about z, 0.3 m long, (n · 80, 3) [m]."""
    angle, z = np.meshgrid(np.linspace(*angles, n), np.linspace(-0.15, 0.15, 80))
    return np.stack([x + a * np.cos(angle), b * np.sin(angle), z], -1).reshape(-1, 3)


def arms():
    return np.concatenate([column(0.045, 0.045, x, n=40) for x in (-0.27, 0.27)])


def test_arms_are_left_out_of_the_surface():
    """They hide the flanks, so that nothing but an arm is on some spokes."""
    front = column(*HALF, angles=(0.3, np.pi - 0.3))

    def radius(cloud):
        options = {"n_theta": 60, "n_z": 8, "z_range": (-0.1, 0.1), "support": None}
        return extract_surface(cloud, axis=AXIS, **options).radius

    found = radius(np.concatenate([front, arms()]))
    np.testing.assert_allclose(found, radius(front), atol=0.003)


def test_what_is_a_limb():
    body, two = column(*HALF), arms()
    np.testing.assert_array_equal(
        trunk(np.concatenate([body, two])),
        np.repeat([True, False], [len(body), len(two)]),
    )
    legs = np.concatenate([column(0.08, 0.08, x) for x in (-0.1, 0.1)])
    assert trunk(legs).all()
    breast = column(0.18, 0.18, angles=(1.0, 2.5), n=40)  # few points, but wide
    assert trunk(np.concatenate([column(0.12, 0.12), breast])).all()


def test_a_radius_that_no_trunk_has_is_told():
    with pytest.warns(TtusWarning, match=r"R reaches 36 cm.*100 % of the nodes"):
        extract_surface(column(0.36, 0.36), axis=AXIS, n_theta=36, n_z=4, support=None)


def test_a_flat_fronts_edges_are_usable():
    """Half the width 22 cm, 11 cm before the axis, 5 mm of noise: r slopes by far."""
    rng = np.random.default_rng(0)
    x, z = rng.uniform(-0.22, 0.22, 60_000), rng.uniform(-0.25, 0.25, 60_000)
    found = usable_range(np.stack([x, rng.normal(0.11, 0.005, x.size), z], axis=1))
    np.testing.assert_allclose([found.z_min, found.z_max], [-0.245, 0.245], atol=0.011)
