"""The Laplace prior and the factor on its boundary values."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.laplace import LaplaceTerm

SCENE = small_scene(shape=(6, 10, 6), n_poses=4)


def test_a_factor_scales_the_boundary_values_alone():
    prior = LaplaceTerm(SCENE, 3.0)
    np.testing.assert_array_equal(prior.assembled.target, SCENE.b)
    scaled = prior.with_factor(1.25)
    np.testing.assert_array_equal(scaled.assembled.target, 1.25 * SCENE.b)
    assert scaled.assembled.blocks["p"] is SCENE.L
    assert (scaled.weight, scaled.formula) == (3.0, "‖L p − 1.25 b‖²")
    assert prior.formula == "‖L p − b‖²"
    other = SCENE.with_boundary(1.25 * SCENE.inner, 1.25 * SCENE.outer)
    np.testing.assert_allclose(scaled.assembled.target, other.b, rtol=1e-14)


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf")])
def test_a_factor_is_positive(factor):
    with pytest.raises(InputError, match="factor on b must be positive"):
        LaplaceTerm(SCENE).with_factor(factor)


def test_the_boundary_scale_is_told_where_it_was_fitted():
    assert LaplaceTerm(SCENE).with_factor(2.0).parameters({}) == {}
    fitted = replace(SCENE, parameters={"boundary_scale": 3.0})
    assert LaplaceTerm(fitted).with_factor(2.0).parameters({}) == {
        "boundary_scale": 6.0
    }
