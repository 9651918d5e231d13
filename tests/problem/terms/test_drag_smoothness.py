"""The prior of drag vanishes where drag is a share of the Laplace field."""

import numpy as np

from tests.conftest import small_scene
from ttus_opt.problem.terms.drag_smoothness import MEAN_FRICTION, DragSmoothnessTerm

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
V = SCENE.n_voxels


def residual(term, q, m):
    rows = term.assembled
    r = rows.blocks["q"] @ q - rows.target
    return r + rows.blocks["m"] @ [m] if "m" in rows.blocks else r


def test_a_share_of_the_laplace_field_costs_nothing():
    field = np.linalg.solve(SCENE.L.toarray(), SCENE.b)
    free, held = DragSmoothnessTerm(SCENE), DragSmoothnessTerm(SCENE, has_mean=False)
    np.testing.assert_allclose(residual(free, 0.3 * field, 0.3), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        residual(held, 0.3 * field, 0.3), 0.3 * SCENE.b, atol=1e-9
    )
    np.testing.assert_allclose(residual(held, np.zeros(V), 0.0), 0.0)


def test_its_rows_are_l_q_less_m_b():
    q = np.random.default_rng(0).normal(size=V)
    expected = SCENE.L @ q - 0.7 * SCENE.b
    np.testing.assert_allclose(residual(DragSmoothnessTerm(SCENE), q, 0.7), expected)


def test_the_mean_is_found_or_given_up():
    term, values = DragSmoothnessTerm(SCENE, 2.0), {"m": np.array([0.25])}
    assert term.parameters(values) == {MEAN_FRICTION: 0.25}
    fitted = term.fitted(values)[MEAN_FRICTION]
    np.testing.assert_array_equal(fitted.gradient["m"], [1.0])
    neutral = term.with_neutral([MEAN_FRICTION])
    assert not neutral.has_mean and neutral.weight == 2.0
    assert neutral.parameters(values) == {MEAN_FRICTION: 0.0}
    assert not neutral.fitted(values)
    assert term.with_neutral(["another"]) is term
    # said for a reader: the formula follows
    assert "m b" in term.formula and "m b" not in neutral.formula
