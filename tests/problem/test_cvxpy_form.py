"""Programs in cvxpy's words: values and multipliers back by name, cones too."""

from typing import Any, cast

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

from tests.solvers.problems import bounds, program, rows, term
from ttus_opt.problem.cvxpy_form import CvxpyProgram
from ttus_opt.problem.members import ProgramCones
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Absolute
from ttus_opt.problem.verify.kkt import kkt_residuals


def solved(stated):
    form = CvxpyProgram.of(stated)
    form.problem.solve(solver=cp.CLARABEL)
    return form


def test_rows_of_every_kind_have_their_multiplier():
    """min ‖x − t‖² with an equality, a row held from above, one from below, a bound."""
    t = np.array([3.0, -2.0, 5.0, 1.0])
    stated = program(
        [term(np.eye(4), t)],
        [
            rows("sum", [[1, 1, 0, 0]], [0.0], [0.0]),
            rows("sides", [[0, 0, 2, 0], [0, 0, 0, 1]], [-np.inf, 2.0], [6.0, np.inf]),
        ],
        [bounds("box", [-9, -9, -9, -9], [2.0, 9, 9, 9])],
    )
    form = solved(stated)
    x, duals = form.point(), form.duals()
    np.testing.assert_allclose(x, [2.0, -2.0, 3.0, 2.0], atol=1e-6)
    # 2 (x − t) + Aᵀy + z = 0
    np.testing.assert_allclose(duals.rows["sum"], [0.0], atol=1e-5)
    np.testing.assert_allclose(duals.rows["sides"], [2.0, -2.0], atol=1e-5)
    np.testing.assert_allclose(duals.bounds, [2.0, 0.0, 0.0, 0.0], atol=1e-5)
    assert kkt_residuals(stated, x, duals).worst_relative < 1e-6
    assert set(form.constraints) == {"sum", "sides", "bounds"}


def test_cones_of_several_sizes():
    """(x₀, x₁, x₂) in a cone of three and x₃ in one of one row: a sign."""
    cones = ProgramCones("cones", sp.csr_array(sp.eye_array(4)), np.zeros(4), (3, 1))
    t = np.array([0.0, 3.0, 4.0, -1.0])
    stated = Program(
        {"p": slice(0, 4)}, (term(np.eye(4), t),), (), (), cast(Any, None), (cones,)
    )
    form = solved(stated)
    x = form.point()
    np.testing.assert_allclose(x, [2.5, 1.5, 2.0, 0.0], atol=1e-5)
    y = form.duals().rows["cones"]
    np.testing.assert_allclose(y, -2.0 * (x - t), atol=1e-4)
    assert kkt_residuals(stated, x, form.duals()).worst_relative < 1e-5


def test_a_bent_penalty_gives_its_subgradient():
    """min |x − 1| + ‖x‖²: x = ½, where the slope of the first is −1."""
    stated = program(
        [term([[1.0]], [1.0], 1.0, Absolute(), "bent"), term([[1.0]], [0.0])]
    )
    form = solved(stated)
    assert form.point() == pytest.approx([0.5], abs=1e-5)
    assert form.duals().terms["bent"] == pytest.approx([-1.0], abs=1e-5)
    assert CvxpyProgram.of(stated).point() is None  # before it is solved
