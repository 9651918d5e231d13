import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.kit import InputError, refuses
from ttus_opt.phantom.probe import EllipsoidProbe


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6))
def test_rays_leave_on_the_surface_and_nowhere_later(seed):
    rng = np.random.default_rng(seed)
    semi = rng.uniform(0.01, 0.04, 3)
    probe = EllipsoidProbe(tuple(semi))
    rotation = Rotation.random(rng=rng).as_matrix()
    position = rng.normal(size=3)
    points = position + 0.05 * rng.normal(size=(200, 3))
    rays = rng.normal(size=(200, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)

    def level(at):
        return np.linalg.norm((at - position) @ rotation / semi, axis=-1)

    depth, normals = probe.reach(points, rays, rotation, position)
    hit = np.isfinite(depth)
    leave = points[hit] + depth[hit, None] * rays[hit]
    assert level(leave) == pytest.approx(1.0, abs=1e-9)
    assert (level(leave + 1e-5 * rays[hit]) > 1.0).all()
    # Normals against a difference of the level function.
    for axis in range(3):
        h = np.zeros(3)
        h[axis] = 1e-7
        slope = (level(leave + h) - level(leave - h)) / 2e-7
        scale = np.linalg.norm((leave - position) @ rotation / semi**2, axis=1)
        assert slope == pytest.approx(normals[hit, axis] * scale, abs=1e-5)
    # Rays said to miss stay outside: look along them.
    along = np.linspace(-0.5, 0.5, 501)
    missed = points[~hit, None] + along[:, None] * rays[~hit, None]
    assert (level(missed) > 1.0 - 1e-3).all()


def test_support_of_a_level_probe_is_its_semi_axis():
    probe = EllipsoidProbe((0.03, 0.0125, 0.018))
    assert probe.support(np.eye(3), np.array([0.0, 0.0, 1.0])) == pytest.approx(0.018)
    turned = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    assert probe.support(turned, np.array([0.0, 0.0, 1.0])) == pytest.approx(0.03)


@pytest.mark.parametrize("semi", [(0.0, 1.0, 1.0), (1.0, 1.0), (np.nan, 1.0, 1.0)])
def test_refuses_what_is_no_ellipsoid(semi):
    refuses(InputError, "semi_axes", EllipsoidProbe, semi)
