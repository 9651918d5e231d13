"""A sorted program has the same minimiser and multipliers as the one it was made of."""

import numpy as np
import pytest

from tests.solvers.problems import INF, bounds, program, rows, term
from ttus_opt.problem.terms.penalties import Absolute, Huber
from ttus_opt.solvers.proximal.penalised_rows import Between
from ttus_opt.solvers.proximal.problem import BOX, PenalisedProblem

N = 6


def mixed():
    """Every kind of member: 3 x₀ = 6 and −2 x₄ = 1 give values, x₁ + x₂ = 1 none."""
    rng = np.random.default_rng(0)
    given = np.zeros((3, N))
    given[0, 0], given[1, [1, 2]], given[2, 4] = 3.0, 1.0, -2.0
    lower, upper = np.full(N, -INF), np.full(N, INF)
    upper[0], lower[3], upper[3], lower[5] = 5.0, -0.1, 0.1, 0.2
    return program(
        [
            term(rng.normal(size=(9, N)), rng.normal(size=9), 2.0),
            term(rng.normal(size=(4, N)), rng.normal(size=4), 0.5, Absolute(), "bent"),
            term(rng.normal(size=(3, N)), rng.normal(size=3), 0.7, Huber(0.3), "soft"),
            term(np.eye(N), np.ones(N), 0.0, name="nothing"),
        ],
        [
            rows("held", given, [6.0, 1.0, 1.0], [6.0, 1.0, 1.0]),
            rows("cut", rng.normal(size=(2, N)), [-INF, -0.2], [0.1, INF]),
        ],
        [bounds("box", lower, upper)],
    )


def test_rows_of_one_entry_give_values_and_the_rest_is_kept():
    problem = PenalisedProblem.of(mixed())
    np.testing.assert_array_equal(problem.values, [2.0, 0, 0, 0, -0.5, 0])
    np.testing.assert_array_equal(np.flatnonzero(problem.fixed), [0, 4])
    np.testing.assert_array_equal(problem.given["held"], [True, False, True])
    assert not problem.given["cut"].any()
    names = [block.name for block in problem.blocks]
    assert names == ["fit", "bent", "soft", "held", "cut", BOX]
    assert [block.name for block in problem.bent] == ["bent", "held", "cut", BOX]
    # the box leaves out variables whose value is given: 0 here
    box = problem.blocks[-1]
    np.testing.assert_array_equal(box.matrix.toarray(), np.eye(N)[[3, 5]])
    assert isinstance(box.law, Between)
    np.testing.assert_array_equal(box.law.lower, [-0.1, 0.2])
    np.testing.assert_array_equal(box.law.upper, [0.1, INF])


def penalised_value(problem, x):
    """Objective by the blocks; infinite outside limits."""
    total = 0.0
    for block in problem.blocks:
        r = block.residual(x)
        if isinstance(block.law, Between):
            inside = (r >= block.law.lower - 1e-12) & (r <= block.law.upper + 1e-12)
            total += 0.0 if inside.all() else INF
        else:
            total += block.weight * block.law.value(r)
    return total


def obeyed(constraint, x):
    r = constraint.matrix @ x
    above, below = r - constraint.lower, constraint.upper - r
    return bool(min(above.min(), below.min()) >= -1e-12)


def test_blocks_say_what_the_program_says():
    what = mixed()
    problem, rng = PenalisedProblem.of(what), np.random.default_rng(1)
    n_inside = 0
    for _ in range(500):
        x = 0.3 * rng.normal(size=N)
        x[problem.fixed] = problem.values[problem.fixed]
        x[2], x[3], x[5] = 1.0 - x[1], np.clip(x[3], -0.12, 0.12), 0.3
        lower, upper = what.box
        in_box = bool(((x >= lower) & (x <= upper)).all())
        feasible = in_box and all(obeyed(c, x) for c in what.constraints)
        n_inside += feasible
        told = penalised_value(problem, x)
        assert np.isfinite(told) == feasible
        if feasible:
            assert told == pytest.approx(what.objective(x))
    assert 20 < n_inside < 480


def pulled(problem, y):
    """Σ Mᵀy over all blocks."""
    parts = [b.adjoint(v) for b, v in zip(problem.blocks, y, strict=True)]
    return np.asarray(np.sum(parts, axis=0))


def test_multipliers_by_name_balance_the_program_s_gradient():
    """Of any multipliers: what they leave of the gradient is what the blocks leave."""
    what = mixed()
    problem, rng = PenalisedProblem.of(what), np.random.default_rng(2)
    y = [rng.normal(size=len(block.target)) for block in problem.blocks]
    left = pulled(problem, y)
    duals = problem.duals(y, left)
    total = y[0] @ what.terms[0].matrix  # the squares' own gradient here
    for each in what.terms[1:3]:
        multiplier = duals.terms.get(each.name)
        if multiplier is None:  # smooth enough to have none
            multiplier = y[2] / each.weight
        total = total + each.weight * (each.matrix.T @ multiplier)
    for constraint in what.constraints:
        total = total + constraint.matrix.T @ duals.rows[constraint.name]
    total = total + duals.bounds
    np.testing.assert_allclose(total[problem.fixed], 0.0, atol=1e-12)
    free = ~problem.fixed
    np.testing.assert_allclose(total[free], left[free], atol=1e-12)
    assert set(duals.rows) == {"held", "cut"}
    assert not duals.bounds[[0, 1, 2, 4]].any()
