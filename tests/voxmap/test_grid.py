import math

import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.voxmap.grid import CylindricalGrid, flat_index, nodes_of

GRID = CylindricalGrid(0.03, 0.13, 0.0, 0.2, (6, 8, 5))


def test_centres_and_steps():
    assert GRID.n_voxels == 240
    np.testing.assert_allclose(GRID.r[[0, -1]], [0.03, 0.13])
    np.testing.assert_allclose(np.diff(GRID.r), GRID.r_step)
    np.testing.assert_allclose(GRID.theta[-1] + GRID.theta_step, 2 * math.pi)
    np.testing.assert_allclose(GRID.z[[0, -1]], [0.0, 0.2])


def test_layout_is_c_order_in_numpy_and_in_kernels():
    values = np.arange(240).reshape(6, 8, 5)
    flat = GRID.flatten(values)
    assert flat[flat_index(3, 4, 2, 8, 5)] == values[3, 4, 2]
    np.testing.assert_array_equal(GRID.unflatten(flat), values)
    assert np.dot(GRID.strides, (3, 4, 2)) == flat_index(3, 4, 2, 8, 5)
    np.testing.assert_array_equal(values[nodes_of(flat[7:70], GRID.shape)], flat[7:70])


@pytest.mark.parametrize(
    ("change", "error", "word"),
    [
        ({"shape": (6, 0, 5)}, InputError, "n_theta"),
        ({"shape": (6, 8)}, InputError, "3 counts"),
        ({"r_outer": 0.02}, GeometryError, "r_outer"),
        ({"z_max": 0.0}, GeometryError, "z_max"),
        ({"r_inner": float("nan")}, InputError, "finite"),
        ({"r_inner": 0.001}, GeometryError, "half a radial step"),
    ],
)
def test_refuses_what_is_no_grid(change, error, word):
    given = {
        "r_inner": 0.03,
        "r_outer": 0.13,
        "z_min": 0.0,
        "z_max": 0.2,
        "shape": (6, 8, 5),
    }
    refuses(error, word, CylindricalGrid, **(given | change))


def test_wrong_lengths_are_named():
    refuses(InputError, r"\(6, 8, 5\)", GRID.flatten, np.zeros((8, 6, 5)))
    refuses(InputError, "240", GRID.unflatten, np.zeros(239))


def test_cylindrical_angles_lie_in_the_first_turn():
    points = np.array([[1.0, -1e-18, 0.5], [0.0, -2.0, 1.0], [-1.0, 0.0, 0.0]])
    r, theta, z = cylindrical(points)
    np.testing.assert_allclose(r, [1, 2, 1])
    np.testing.assert_allclose(theta, [0, 1.5 * math.pi, math.pi])
    assert (theta < 2 * math.pi).all()
    np.testing.assert_allclose(z, [0.5, 1.0, 0.0])
