import numpy as np
import pytest

import ttus_opt as tt
from ttus_opt import example
from ttus_opt.haptic.depth_stop import DepthStop


def test_positions_within_the_model_are_left_alone():
    stop, at = DepthStop(0.05), np.array([0.06, 0.0, 0.1])
    assert stop(at) is at
    assert not stop.acts


def test_the_last_place_holds_through_the_axis_and_out_again():
    stop = DepthStop(0.05)
    for x in np.linspace(0.06, -0.2, 50):
        held = stop(np.array([x, 0.01, 0.1]))
        assert np.hypot(*held[:2]) >= 0.05 - 1e-12
        assert held[0] > 0.0
        assert held[2] == 0.1
    assert stop.acts
    for x in np.linspace(-0.2, 0.06, 50):
        held = stop(np.array([x, 0.01, 0.1]))
    assert not stop.acts
    np.testing.assert_array_equal(held, [0.06, 0.01, 0.1])


def test_it_moves_without_jumps():
    stop, rng = DepthStop(0.05), np.random.default_rng(0)
    at, last = np.array([0.07, 0.0, 0.1]), None
    for _ in range(20_000):
        step = 1e-4 * rng.standard_normal(2) - 2e-3 * (at[:2] - [0.04, 0.0])
        at = at + np.array([*step, 0.0])
        held = stop(at)
        if last is not None:
            assert np.linalg.norm(held - last[0]) <= 3.0 * np.linalg.norm(at - last[1])
        last = held, at


def test_on_the_axis_at_once():
    np.testing.assert_allclose(DepthStop(0.05)(np.zeros(3)), [0.05, 0, 0])


def test_force_never_falls_on_the_way_to_the_axis():
    surface = tt.Surface.load(example.path("surface.nc"))
    voxmap = tt.Voxmap.from_surface(surface, shape=(24, 72, 30), r_inner=0.03)
    shell = tt.PointShell.from_spec(example.PROBE, n_points=500)
    depth = voxmap.spoke_radius - voxmap.grid.r[:, None, None]
    field = tt.PotentialField(voxmap, 200.0 * depth, "trilinear")
    renderer = tt.Renderer(field, shell, force_limit=1e6, torque_limit=1e6)
    reach = np.linalg.norm(shell.points - shell.reference, axis=1).max()
    stop, plain, held = DepthStop(0.03 + reach), [], []
    for r in np.linspace(0.14, 0.0, 60):
        at = np.array([0.0, r, 0.15])
        plain.append(renderer.render(np.eye(3), at).force[1])
        held.append(renderer.render(np.eye(3), stop(at)).force[1])
    assert plain[-1] < 0.1 * max(plain)  # what it is for
    assert (np.diff(held) >= -1e-6 * max(held)).all()
    assert held[-1] == pytest.approx(max(held))
