"""Coulomb's limit of a drag field."""

import numpy as np

from tests.problem.constraints.declared import REGION, SCENE, linear
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.drag_limit import DragLimit


def test_drag_limit_is_a_share_of_the_field():
    rows = linear(DragLimit(SCENE, 0.4).rows())
    p, q = np.random.default_rng(0).normal(size=(2, SCENE.n_voxels))
    value = rows.blocks["p"] @ p + rows.blocks["q"] @ q
    beside = REGION.reshape(-1) != 0
    np.testing.assert_allclose(value, 0.4 * p[beside] - q[beside])
    inside = REGION.reshape(-1)[beside] > 0
    np.testing.assert_array_equal(rows.lower == 0.0, inside)
    np.testing.assert_array_equal(rows.upper == 0.0, ~inside)


def test_a_limit_that_is_none_is_refused():
    refuses(InputError, "largest friction must lie between", DragLimit, SCENE, 0.0)
