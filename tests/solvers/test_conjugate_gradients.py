"""Conjugate gradients on dense systems: with all directions kept, and with the last."""

import numpy as np

from ttus_opt.solvers.conjugate_gradients import (
    RecycledSubspace,
    conjugate_gradients,
    norm,
    to_residual,
)
from ttus_opt.solvers.dual.linear_parameters import Complement

M = 12


class Dense:
    """S = I + w K w."""

    def __init__(self, w):
        root = np.random.default_rng(0).normal(size=(M, M)) * 10.0 ** np.linspace(
            -2, 2, M
        )
        self.root_weights, self.calls = w, 0
        self.S = np.eye(M) + w[:, None] * (root @ root.T) * w

    def apply(self, y, rtol):
        self.calls += 1
        return self.S @ y


def everything(columns=None):
    """The whole space, or what lies across some columns; no preconditioner."""
    return Complement(np.zeros((M, 0)) if columns is None else columns, lambda r: r)


def solved(subspace, t, space=None, most=200):
    goal = 1e-10 * float(np.linalg.norm(t))
    run = (space or everything()).solve(subspace, t, lambda y: goal, most)
    return run.y, run.steps


def test_solves_and_keeps_conjugate_directions():
    system = Dense(np.ones(M))
    subspace = RecycledSubspace(system)
    t = np.random.default_rng(1).normal(size=M)
    y, steps = solved(subspace, t)
    np.testing.assert_allclose(system.S @ y, t, atol=1e-9 * np.linalg.norm(t))
    assert steps == len(subspace) == system.calls <= M + 2
    d, images = subspace._kept
    np.testing.assert_allclose(d @ images.T, np.eye(len(d)), atol=1e-7)
    # the same space once more: nothing is applied
    calls = system.calls
    again, none = solved(subspace, 2.0 * t)
    assert (none, system.calls) == (0, calls)
    np.testing.assert_allclose(again, 2.0 * y, rtol=1e-6)


def test_directions_are_limited_and_nonsense_is_not_kept():
    subspace = RecycledSubspace(Dense(np.ones(M)))
    _, steps = solved(subspace, np.ones(M), most=3)
    assert steps == len(subspace) == 3
    assert not subspace.extend(np.full(M, np.nan), 0.0)
    assert len(subspace) == 3


class Rough(Dense):
    """Products that are off by a thousandth."""

    def apply(self, y, rtol):
        exact = super().apply(y, rtol)
        noise = np.random.default_rng(self.calls).normal(size=M)
        return exact + 1e-3 * np.linalg.norm(exact) * noise / np.sqrt(M)


def test_of_rough_products_the_rest_is_conjugate_all_the_same():
    """What one pass leaves by a thousandth two leave by a millionth."""
    subspace = RecycledSubspace(Rough(np.full(M, 1e-2)))
    rng, sizes = np.random.default_rng(8), []
    for k, direction in enumerate(rng.normal(size=(5, M))):
        subspace.extend(direction, 0.0)
        d, images = subspace._kept
        sizes.append(np.abs(images[:k] @ d[k]).max(initial=0.0))
    d, images = subspace._kept
    y = rng.normal(size=M)
    parts, rest = subspace.parts(y)
    np.testing.assert_allclose(parts @ d + rest, y, atol=1e-10)
    left, before = (np.abs(images @ each).max() for each in (rest, y))
    assert left < 1e-5 * before and max(sizes) < 1e-5


class Diagonal:
    """Fifty eigenvalues, none like another."""

    root_weights = np.ones(50)
    S = np.diag(np.linspace(1.0, 99.0, 50))

    def apply(self, y, rtol):
        return self.S @ y


class Asked(Diagonal):
    """With the accuracy that was asked of each product."""

    def __init__(self):
        self.rtol: list[float] = []

    def apply(self, y, rtol):
        self.rtol.append(rtol)
        return super().apply(y, rtol)


def test_each_product_is_as_accurate_as_its_residual_asks():
    """Residuals anew, by runs of fewer steps."""
    system, t = Asked(), np.random.default_rng(11).normal(size=50)

    def run(operator, most):
        return conjugate_gradients(
            RecycledSubspace(operator),
            t,
            np.copy,
            lambda _, rest: norm(rest) <= 1e-9,
            most,
            lambda rest: 1e-3 / norm(rest),
        )

    steps = run(system, 200).steps
    left = [np.linalg.norm(t - Diagonal.S @ run(Diagonal(), k).y) for k in range(steps)]
    np.testing.assert_allclose(system.rtol, 1e-3 / np.array(left), rtol=0.01)


def test_the_best_so_far_is_the_answer_where_no_direction_is_left():
    """The third direction makes things worse, the fourth is nonsense."""
    system, t = Diagonal(), np.random.default_rng(12).normal(size=50)
    given = []

    class Wild(RecycledSubspace):
        def project(self, right_side):
            step, rest = super().project(right_side)
            return (1e3 * step, 1e3 * rest) if len(given) == 3 else (step, rest)

    def precondition(rest):
        given.append(rest)
        return rest if len(given) < 4 else np.full(50, np.nan)

    run = conjugate_gradients(Wild(system), t, precondition, lambda _, rest: False, 200)
    assert run.steps == 3
    np.testing.assert_array_equal(run.rest, given[2])
    np.testing.assert_allclose(t - system.S @ run.y, run.rest, atol=1e-12)


def test_it_ends_where_residuals_explode():
    system, t = Diagonal(), np.ones(50)

    class Wild(RecycledSubspace):
        def project(self, right_side):
            step, rest = super().project(right_side)
            return step, 1e7 * rest if len(self) else rest

    run = conjugate_gradients(Wild(system), t, np.copy, lambda _, rest: False, 200)
    assert run.steps == 1 and not run.y.any()


def test_there_is_room_for_any_number_of_directions():
    """One for each eigenvalue, and none is lost as the store grows."""
    subspace = RecycledSubspace(Diagonal())
    for direction in np.random.default_rng(9).normal(size=(50, 50)):
        assert subspace.extend(direction, 0.0)
    d, images = subspace._kept
    assert len(subspace) == 50
    np.testing.assert_allclose(d @ images.T, np.eye(50), atol=1e-5)
    t = np.random.default_rng(10).normal(size=50)
    y, rest = subspace.project(t)
    np.testing.assert_allclose(Diagonal.S @ y, t, atol=1e-4)
    assert np.abs(rest).max() < 1e-4


def test_nothing_to_solve_takes_no_step():
    subspace = RecycledSubspace(Dense(np.ones(M)))
    y, steps = solved(subspace, np.zeros(M))
    assert not y.any() and steps == len(subspace) == 0


def test_dependent_directions_are_dropped_with_other_weights():
    subspace, rng = RecycledSubspace(Dense(np.ones(M))), np.random.default_rng(7)
    for direction in rng.normal(size=(3, M)):
        subspace.extend(direction, 0.0)
    subspace._store[:, 3:5], subspace._count = subspace._store[:, 1:3], 5
    second = Dense(np.linspace(0.5, 2.0, M))
    subspace.adopt(second)
    assert len(subspace) == 3
    gram = subspace.directions @ second.S @ subspace.directions.T
    np.testing.assert_allclose(gram, np.eye(3), atol=1e-8)


N = 40


def matrix(seed=0, condition=1e4):
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(N, N)))
    return np.asarray((turn * np.geomspace(1.0, condition, N)) @ turn.T)


def reached(H, side, precondition, rtol=1e-10, most=500):
    return to_residual(lambda v: H @ v, side, precondition, rtol, most, None)


def wavering(H):
    """About H⁻¹, another at every call and not quite linear."""
    inverse, rng = np.linalg.inv(H), np.random.default_rng(9)

    def apply(v):
        z = inverse @ v
        return np.asarray(z * (1.0 + 0.1 * rng.uniform(-1.0, 1.0, N)))

    return apply


def test_a_wavering_preconditioner_costs_few_steps():
    """Fletcher and Reeves' rule, which asks for a fixed one, needs far more."""
    H, side = matrix(), np.random.default_rng(1).normal(size=N)
    found = reached(H, side, wavering(H))
    precondition = wavering(H)
    d, rest = np.zeros(N), side.copy()
    z = precondition(rest)
    direction, energy, steps = z.copy(), rest @ z, 0
    while np.linalg.norm(rest) > 1e-10 * np.linalg.norm(side) and steps < 500:
        alpha = energy / (direction @ H @ direction)
        d, rest = d + alpha * direction, rest - alpha * (H @ direction)
        z = precondition(rest)
        beta, energy = rest @ z / energy, rest @ z
        direction, steps = z + beta * direction, steps + 1
    assert found.steps < 0.6 * steps


def test_with_a_fixed_one_errors_fall_as_those_of_conjugate_gradients():
    """k steps minimise the energy over the Krylov space."""
    H, side = matrix(condition=50.0), np.random.default_rng(2).normal(size=N)
    exact = np.linalg.solve(H, side)
    krylov = [side]
    for k in range(1, 6):
        found = reached(H, side, lambda v: v.copy(), 0.0, k)
        basis, _ = np.linalg.qr(np.array(krylov).T)
        best = basis @ np.linalg.solve(basis.T @ H @ basis, basis.T @ side)
        assert found.steps == k
        np.testing.assert_allclose(found.y, best, atol=1e-8 * np.abs(exact).max())
        krylov.append(H @ krylov[-1])


def test_it_stops_where_it_is_told_to():
    H, side = matrix(), np.random.default_rng(3).normal(size=N)
    assert reached(H, side, lambda v: v, most=0).steps == 0
    late = to_residual(lambda v: H @ v, side, lambda v: v.copy(), 1e-10, 99, 0.0)
    assert late.steps == 0 and not late.y.any()
    none = reached(H, np.zeros(N), lambda v: v.copy())
    assert none.steps == 0 and not none.y.any()


def test_a_direction_without_curvature_ends_it():
    """A semidefinite H: what its rows determine is found, the rest stays at zero."""
    H = np.diag([1.0, 2.0, 0.0])
    found = reached(H, np.array([1.0, 1.0, 0.0]), lambda v: v.copy(), 1e-12, 50)
    np.testing.assert_allclose(found.y, [1.0, 0.5, 0.0], atol=1e-12)
    flat = reached(np.zeros((3, 3)), np.ones(3), lambda v: v.copy())
    assert flat.steps == 0 and not flat.y.any()
