"""Objective, gradient and the QP forms of a program, against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import InputError, refuses, small_scene
from ttus_opt.problem.constraints.base import Bounds, Constraint, LinearRows
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program, QuadraticForm
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.penalties import Absolute, Linear
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm

TINY = small_scene(shape=(5, 6, 4), n_poses=5)
RNG = np.random.default_rng(0)


class TwoVariables(Term):
    """p beside a variable s of three entries."""

    name = "two"
    formula = "‖A p + B s − t‖²"

    def rows(self):
        rng = np.random.default_rng(9)
        A = sp.random_array((4, self.scene.n_voxels), density=0.1, rng=rng)
        B = sp.random_array((4, 3), density=1.0, rng=rng)
        return AffineRows({"p": sp.csr_array(A), "s": sp.csr_array(B)}, np.ones(4))


EQ10 = [LaplaceTerm(TINY), ForceTerm(TINY, 0.3), TorqueTerm(TINY, 0.2)]


def test_objective_is_the_sum_of_the_weighted_costs():
    program = Program.build(TINY, EQ10, [])
    p = RNG.normal(size=TINY.n_voxels)
    length = TINY.torque_length
    by_hand = {
        "laplace": np.sum((TINY.L @ p - TINY.b) ** 2),
        "force": 0.3 * np.sum((TINY.N @ p - TINY.f) ** 2),
        "torque": 0.2 * np.sum((TINY.W @ p - TINY.tau) ** 2) / length**2,
    }
    costs = program.costs(p)
    assert costs == pytest.approx(by_hand)
    assert program.objective(p) == pytest.approx(sum(by_hand.values()))


def test_normal_equations_are_the_dense_ones():
    program = Program.build(TINY, EQ10, [])
    L, N, W = (M.toarray() for M in (TINY.L, TINY.N, TINY.W / TINY.torque_length))
    tau = TINY.tau / TINY.torque_length
    Q, d = program.normal_equations()
    np.testing.assert_allclose(
        Q.toarray(), L.T @ L + 0.3 * N.T @ N + 0.2 * W.T @ W, atol=1e-12
    )
    np.testing.assert_allclose(
        d, L.T @ TINY.b + 0.3 * N.T @ TINY.f + 0.2 * W.T @ tau, atol=1e-10
    )


def explicit_qp(program):
    """The QP with P = 2Q formed, by the definition."""
    Q, d = program.normal_equations()
    rows = program.constraints
    limits = [
        np.concatenate([getattr(c, side) for c in rows]) for side in ("lower", "upper")
    ]
    n = program.n_variables
    A = sp.vstack([sp.csr_array((0, n)), *(c.matrix for c in rows)])
    return QuadraticForm(
        sp.csc_array(2.0 * Q), -2.0 * d, sp.csc_array(A), *limits, *program.box
    )


def lifted_value(form, x):
    return float(0.5 * x @ (form.P @ x) + form.q @ x)


def test_explicit_and_least_squares_forms_say_the_same():
    """Same objective up to the constant at any x, with u as the rows demand."""
    program = Program.build(
        TINY, [*EQ10, TwoVariables(TINY)], [HardBoundary(TINY), Sign(TINY)]
    )
    explicit, squares = explicit_qp(program), program.least_squares_qp()
    n, m = program.n_variables, squares.n_lifted
    assert squares.A.shape == (m + explicit.A.shape[0], n + m)
    constant = program.objective(np.zeros(n))
    for _ in range(3):
        x = RNG.normal(size=n)
        u = squares.A[:m, :n] @ x - squares.lower[:m]
        both = np.concatenate([x, u])
        # the lifted rows hold with equality at this u
        np.testing.assert_allclose((squares.A @ both)[:m], squares.upper[:m])
        np.testing.assert_allclose((squares.A @ both)[m:], explicit.A @ x)
        value = program.objective(x)
        assert lifted_value(squares, both) == pytest.approx(value)
        assert lifted_value(explicit, x) + constant == pytest.approx(value)
    np.testing.assert_array_equal(squares.lb[:n], explicit.lb)
    np.testing.assert_array_equal(squares.ub[:n], explicit.ub)
    assert not np.isfinite(squares.ub[n:]).any()


def test_a_linear_penalty_goes_into_q_and_d():
    plain = Program.build(TINY, EQ10, [])
    c = RNG.normal(size=TINY.n_voxels)
    row = sp.csr_array(c[None])
    slope = ProgramTerm("slope", 2.0, row, np.array([0.5]), Linear())
    program = replace(plain, terms=(*plain.terms, slope))
    x = RNG.normal(size=TINY.n_voxels)
    assert program.is_quadratic
    assert program.objective(x) == pytest.approx(
        plain.objective(x) + 2.0 * (float(c @ x) - 0.5)
    )
    np.testing.assert_allclose(
        np.add(*program.gradient(x)), np.add(*plain.gradient(x)) + 2.0 * c
    )
    Q, d = program.normal_equations()
    np.testing.assert_allclose(2 * (Q @ x - d), np.add(*program.gradient(x)), atol=1e-9)
    form = program.least_squares_qp()
    np.testing.assert_allclose(form.q[: len(x)], 2.0 * c)
    assert form.n_lifted == plain.least_squares_qp().n_lifted


def test_variables_of_two_sizes_are_refused():
    class Other(Constraint):
        name, formula = "other", "s ≥ 0"

        def rows(self):
            return Bounds("s", np.zeros(5), np.ones(5))

    with pytest.raises(InputError, match="'s' 5 entries, others 3"):
        Program.build(TINY, [TwoVariables(TINY)], [Other(TINY)])


def test_the_box_is_the_tightest_of_all_bounds():
    class Cap(Constraint):
        name, formula = "cap", "p ≤ 1"

        def rows(self):
            V = self.scene.n_voxels
            return Bounds("p", np.full(V, -1.0), np.full(V, 1.0))

    program = Program.build(TINY, [LaplaceTerm(TINY)], [Sign(TINY), Cap(TINY)])
    lower, upper = program.box
    region = TINY.voxmap.region.reshape(-1)
    np.testing.assert_array_equal(lower, np.where(region > 0, 0.0, -1.0))
    np.testing.assert_array_equal(upper, np.where(region < 0, 0.0, 1.0))


def test_bent_penalties_have_no_quadratic_form():
    program = Program.build(TINY, EQ10, [])
    bent = replace(program.terms[1], penalty=Absolute())
    program = replace(program, terms=(program.terms[0], bent))
    assert not program.is_quadratic
    refuses(InputError, "force is not a sum of squares", program.least_squares_qp)
    with pytest.raises(InputError, match="force is not a sum of squares"):
        program.gradient(np.zeros(TINY.n_voxels))


def test_constraint_rows_keep_their_limits():
    class Band(Constraint):
        name, formula = "band", "-1 ≤ p₀ ≤ 2"

        def rows(self):
            row = sp.csr_array(([1.0], ([0], [0])), shape=(1, self.scene.n_voxels))
            return LinearRows({"p": row}, np.array([-1.0]), np.array([2.0]))

    program = Program.build(TINY, [LaplaceTerm(TINY)], [Band(TINY), HardBoundary(TINY)])
    form = explicit_qp(program)
    assert (form.lower[0], form.upper[0]) == (-1.0, 2.0)
    np.testing.assert_array_equal(form.lower[1:], form.upper[1:])
    x = np.full(TINY.n_voxels, 3.0)
    assert program.constraints[0].slack(x).tolist() == [-1.0]


def test_without_bounds_the_box_takes_no_memory():
    lower, upper = Program.build(TINY, [LaplaceTerm(TINY)], []).box
    assert lower.shape == upper.shape == (TINY.n_voxels,)
    assert (lower == -np.inf).all() and (upper == np.inf).all()
    assert lower.strides == upper.strides == (0,)
