"""One frame by hand: a sphere over a field that grows with depth, and its limits."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError
from ttus_opt.contact.rows import contact_rows
from ttus_opt.haptic.field_wrench import FORCE_LIMIT, TORQUE_LIMIT, over_limits
from ttus_opt.haptic.wrench import BY_FORCE, _cut, mixed

#: A round body, layers exactly on its surface, and a field of 300 N/cm² per metre
RADIUS, SLOPE = 0.1, 300.0


def made():
    surface = tt.Surface.from_radius(np.full((24, 5), RADIUS), np.linspace(0.0, 0.2, 5))
    voxmap = tt.Voxmap.from_surface(
        surface, shape=(10, 24, 5), r_inner=0.03, r_outer=0.12
    )
    depth = RADIUS - voxmap.grid.r
    values = np.broadcast_to(SLOPE * depth[:, None, None], voxmap.grid.shape)
    field = tt.PotentialField(voxmap, values.copy(), "trilinear")
    return field, tt.PointShell.sphere(0.01, n_points=200)


FIELD, SHELL = made()


def test_a_limit_shortens_the_wrench_as_a_whole_and_the_smaller_one_counts():
    R, at = np.eye(3), np.array([RADIUS + 0.004, 0.001, 0.1])
    whole = tt.Renderer(FIELD, SHELL).render(R, at)
    assert whole.limited_by == "" and not whole.saturated
    force, torque = (float(np.linalg.norm(x)) for x in (whole.force, whole.torque))
    for of_force, of_torque, name in ((1.1, 0.5, "torque"), (0.2, 0.5, "force")):
        limits = {"force_limit": of_force * force, "torque_limit": of_torque * torque}
        cut = tt.Renderer(FIELD, SHELL, **limits).render(R, at)
        share = min(of_force, of_torque)
        assert cut.limited_by == name and cut.saturated
        np.testing.assert_allclose(cut.force, share * whole.force, rtol=1e-12)
        np.testing.assert_allclose(cut.torque, share * whole.torque, rtol=1e-12)
    for limit in (0.0, -1.0, math.nan, None):
        with pytest.raises(InputError, match="force_limit must be positive"):
            tt.Renderer(FIELD, SHELL, force_limit=limit)


@pytest.mark.parametrize("sampling", ["trilinear", "contact-size", "contact-size:0.02"])
@pytest.mark.parametrize("end", [0.0, 0.2])
def test_forces_fade_over_the_last_voxel(end, sampling):
    """4 cm deep, across an end: continuous, with drag and without, and named."""
    parameters = {"friction_coefficient": 0.3}
    field = replace(FIELD, sampling=sampling, parameters=parameters)
    renderer = tt.Renderer(field, SHELL, force_limit=1e6, torque_limit=1e6)
    twist = np.array([0.0, 0.05, 0.02, 0.0, 0.0, 0.0])
    inwards, reach = np.sign(0.1 - end), 0.01 + 0.05 + 1e-4  # the sphere and a voxel
    jumps = []
    for n in (601, 1201):
        heights = end + inwards * np.linspace(-0.011, reach, n)
        path = np.array([[0.06, 0.0, z] for z in heights])
        moving, still = (
            [renderer.render(np.eye(3), at, v) for at in path]
            for v in (twist, np.zeros(6))
        )
        force = np.array([np.concatenate([w.force, w.torque]) for w in moving])
        jumps.append(np.abs(np.diff(force, axis=0)).max(axis=0))
        turns = np.tile(np.eye(3), (n, 1, 1))
        rows = contact_rows(field.voxmap, SHELL, turns, path, sampling=sampling)
        own = (rows.N @ field.values.reshape(-1)).reshape(-1, 3)
        np.testing.assert_allclose([w.force for w in still], own, atol=1e-9)
    assert jumps[0].max() < 0.02 * np.abs(force).max()
    assert (jumps[1][[0, 1, 3, 4]] < 0.6 * jumps[0][[0, 1, 3, 4]]).all()
    assert not force[0].any() and force[-1].any()
    names = [w.limited_by for w in moving]
    assert names[0] == names[-1] == ""
    assert set(names[30:1100]) == {"end"} and not moving[600].saturated


@pytest.mark.parametrize("factor", [1e6, 1e77, 1e160])
def test_whatever_a_field_holds_a_hand_survives(factor):
    R, at = np.eye(3), np.array([RADIUS + 0.004, 0.001, 0.1])
    renderer = tt.Renderer(replace(FIELD, values=factor * FIELD.values), SHELL)
    wrench = renderer.render(R, at)
    assert wrench.limited_by
    assert (FORCE_LIMIT, TORQUE_LIMIT) == (40.0, 4.0)  # what a hand holds
    assert np.linalg.norm(wrench.force) <= FORCE_LIMIT * (1 + 1e-12)
    assert np.linalg.norm(wrench.torque) <= TORQUE_LIMIT * (1 + 1e-12)
    assert over_limits(wrench.force[None] * 1.01, wrench.torque[None] * 1.01).all() == (
        factor < 1e160  # where the sum of squares overflows, nothing is rendered
    )


def test_mixing_is_linear():
    a, b = np.arange(4.0), np.arange(4.0)[::-1].copy()
    np.testing.assert_allclose(mixed(a, b, 0.25), 0.75 * a + 0.25 * b)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_wrench_that_is_not_finite_is_none(value):
    wrench = np.array([value, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert _cut(wrench, FORCE_LIMIT, TORQUE_LIMIT) == BY_FORCE
    assert not wrench.any()
