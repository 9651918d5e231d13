"""Terms from cvxpy expressions: verified without cvxpy, multipliers by name."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

from tests.kit import InputError, refuses, small_scene
from ttus_opt.fitting.batch import Fitter, fit
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.problem.solution import Status
from ttus_opt.problem.terms.cvxpy_term import CvxpyTerm
from ttus_opt.problem.verify.kkt import kkt_residuals

SCENE = small_scene("trilinear", shape=(8, 12, 8), n_poses=10)
SHAPE = SCENE.voxmap.grid.shape


def eq10():
    return load("eq10", SCENE, force_weight=1.0, torque_weight=1.0)


IDEAS = {
    "edges of a slice": (lambda p: cp.tv(p[:, :, 4]), "edge:cones"),
    "plateaus": (lambda p: cp.sum(cp.abs(cp.diff(p, axis=2))), "edge:rows"),
    "squares": (lambda p: cp.sum_squares(cp.diff(p, axis=2)) + 3.0, "edge:cones"),
    "largest": (lambda p: cp.max(p[1:5]), "edge:rows"),
}


@pytest.mark.parametrize("idea", IDEAS)
def test_an_idea_is_solved_and_verified(idea):
    """Its cost is the expression's value at the field, its objective cvxpy's own."""
    expression, rows = IDEAS[idea]
    declared = eq10() + CvxpyTerm("edge", expression, 0.05)
    solution = fit(SCENE, declared)
    assert solution.status is Status.SOLVED
    assert rows in solution.duals_by_name
    assert np.abs(solution.duals_by_name[rows]).max() > 1e-3
    field = cp.Constant(solution.field.values)
    own = 0.05 * float(expression(field).value)
    assert solution.costs["edge"] == pytest.approx(own, rel=1e-5)
    # the same problem said to cvxpy from the expression itself
    p = cp.Variable(SHAPE)
    flat = cp.reshape(p, (SCENE.n_voxels,), order="C")
    cost = 0.05 * expression(p)
    for term in eq10().compile().terms:
        cost += term.weight * cp.sum_squares(term.matrix @ flat - term.target)
    problem = cp.Problem(cp.Minimize(cost))
    problem.solve(solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND)
    assert solution.objective == pytest.approx(problem.value, rel=1e-6)


def test_a_wrong_answer_fails_its_check():
    """Another field, a multiplier outside its cone, a multiplier of the wrong size."""
    declared = eq10() + CvxpyTerm("edge", IDEAS["edges of a slice"][0], 0.05)
    solution = fit(SCENE, declared)
    program, x, duals = solution.program, solution.candidate, solution.duals
    assert kkt_residuals(program, x, duals).worst_relative < 1e-6
    assert kkt_residuals(program, 1.01 * x, duals).worst_relative > 1e-4
    y = duals.rows["edge:cones"]
    for wrong in (-y, 1.1 * y, np.zeros_like(y)):
        changed = replace(duals, rows={"edge:cones": wrong})
        assert kkt_residuals(program, x, changed).dual_relative > 1e-4
    # auxiliary variables that claim a smaller cost than the expression has
    cheaper = x.copy()
    cheaper[program.variables["edge:aux"]] *= 0.9
    assert kkt_residuals(program, cheaper, duals).primal_relative > 1e-3


def test_another_weight_is_brought_into_form_once():
    calls = []

    def counted(p):
        calls.append(p)
        return cp.tv(p[:, :, 4])

    declared = eq10() + CvxpyTerm("edge", counted, 0.05)
    declared.compile()
    heavier = declared.with_weights(edge=0.1)
    heavier.compile()
    assert len(calls) == 1
    assert heavier.terms[-1].weight == 0.1
    assert "+ 0.05 · " in str(declared) and "[edge: 1 rows]" in str(declared)
    assert "+ 0.1 · " in str(heavier)


@pytest.mark.parametrize(
    ("expression", "told"),
    [
        (lambda p: cp.log_sum_exp(p), "needs exponential cones"),
        (lambda p: cp.normNuc(p[0]), "needs semidefinite cones"),
        (lambda p: p, "must be a scalar"),
        (lambda p: 3.0, "must be a scalar"),
        (lambda p: -cp.sum_squares(p), "must be convex .* concave"),
        (lambda p: cp.sum_squares(p * np.inf), "holds inf|not finite|NaN"),
        (lambda p: p.nonsense, r"AttributeError.*test_cvxpy_term\.py, line \d+"),
    ],
)
def test_what_cannot_be_taken_is_named(expression, told):
    caught = refuses(InputError, told, (eq10() + CvxpyTerm("edge", expression)).compile)
    assert "edge" in caught


@pytest.mark.slow
def test_a_formulation_in_cvxpys_words():
    """Variables and constraints by name; the same optimum and the same multipliers."""
    declared = load("coulomb_drag", SCENE, force_weight=1.0, torque_weight=1.0)
    said = declared.to_cvxpy()
    assert list(said.variables) == ["p", "q", "m"]
    assert {"drag_limit", "bounds"} <= set(said.constraints)
    said.problem.solve(solver=cp.CLARABEL)
    solution = Fitter(declared).solve()
    assert said.problem.value == pytest.approx(solution.objective, rel=1e-6)
    x = said.point()
    kkt = kkt_residuals(solution.program, x, said.duals())
    assert kkt.worst_relative < 1e-4


def test_a_term_needs_a_scene():
    with pytest.raises(InputError, match="at least one term of a scene"):
        Formulation([CvxpyTerm("edge", cp.sum)])


def test_a_variable_of_its_own_is_refused():
    """It would be a field that nothing else knows, without effect."""
    term = CvxpyTerm("edge", lambda x: cp.tv(x[:, :, 3]))
    with pytest.raises(InputError, match=r"edge takes x, a variable of no other.* p$"):
        (eq10() + term).compile()
