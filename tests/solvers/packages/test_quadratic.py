"""The two shapes of a quadratic program, and signs of multipliers on the way back."""

import numpy as np
import scipy.sparse as sp

from ttus_opt.problem.program import QuadraticForm
from ttus_opt.solvers.packages import quadratic
from ttus_opt.solvers.packages.quadratic import OneSided, TwoSided

INF = np.inf
FORM = QuadraticForm(
    sp.csc_array(np.diag([2.0, 4.0])),
    np.array([1.0, -1.0]),
    sp.csc_array(np.array([[1.0, 1.0], [1.0, -1.0], [2.0, 0.0], [0.0, 3.0]])),
    np.array([1.0, -INF, 0.0, -2.0]),
    np.array([1.0, 5.0, INF, 2.0]),
    np.array([-1.0, -INF]),
    np.array([INF, INF]),
)


def test_one_sided_rows_and_their_multipliers():
    split = OneSided.of(FORM)
    np.testing.assert_array_equal(split.A.toarray(), [[1.0, 1.0]])
    np.testing.assert_array_equal(
        split.G.toarray(), [[1.0, -1.0], [0.0, 3.0], [-2.0, 0.0], [0.0, -3.0]]
    )
    np.testing.assert_array_equal(split.h, [5.0, 2.0, 0.0, 2.0])
    assert split.boxed
    # stationarity of either form: Aᵀy of the rows is Aᵀy + Gᵀz of the split ones
    y, z = np.array([0.5]), np.array([1.0, 2.0, 3.0, 4.0])
    rows = split.sides.multipliers(y, z)
    np.testing.assert_allclose(FORM.A.T @ rows, split.A.T @ y + split.G.T @ z)
    np.testing.assert_array_equal(rows, [0.5, 1.0, -3.0, -2.0])


def test_two_sided_rows_carry_the_box():
    rows = TwoSided.of(FORM)
    np.testing.assert_array_equal(rows.A.toarray()[4:], [[1.0, 0.0]])
    assert (rows.lower[4], rows.upper[4]) == (-1.0, INF)
    own, box = rows.split(np.arange(5.0))
    np.testing.assert_array_equal(own, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(box, [4.0, 0.0])
    assert not OneSided.of(rows.form).boxed
    np.testing.assert_array_equal(rows.form.A.toarray(), rows.A.toarray())


def test_structure_is_pattern_equalities_and_sides():
    rows = TwoSided.of(FORM)
    numbers = FORM.A.copy()
    numbers.data = numbers.data * 2.0
    changed = {
        "numbers": QuadraticForm(FORM.P, FORM.q, numbers, FORM.lower, FORM.upper,
                                 FORM.lb, FORM.ub),
        "side": QuadraticForm(FORM.P, FORM.q, FORM.A, FORM.lower,
                              np.array([1.0, INF, INF, 2.0]), FORM.lb, FORM.ub),
        "box": QuadraticForm(FORM.P, FORM.q, FORM.A, FORM.lower, FORM.upper,
                             np.array([-1.0, 0.0]), FORM.ub),
    }  # fmt: skip
    same = {name: TwoSided.of(f).same_structure(rows) for name, f in changed.items()}
    assert same == {"numbers": True, "side": False, "box": False}


def test_a_pattern_is_shape_columns_and_rows():
    one = sp.csc_matrix([[1.0, 0.0], [0.0, 2.0]])
    assert quadratic._same_pattern(one, 3.0 * one)
    for other in ([[0.0, 2.0], [1.0, 0.0]], [[1.0, 2.0], [0.0, 0.0]], [[1.0], [2.0]]):
        assert not quadratic._same_pattern(one, sp.csc_matrix(other))
