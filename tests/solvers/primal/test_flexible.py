"""Flexible conjugate gradients against dense solves, also where H⁻¹ is not linear."""

from __future__ import annotations

import numpy as np
import pytest

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.primal.flexible import Map, Step, flexible_conjugate_gradients

N = 40


def matrix(seed: int = 0, condition: float = 1e4) -> Array:
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(N, N)))
    return np.asarray((turn * np.geomspace(1.0, condition, N)) @ turn.T)


def run(
    H: Array, side: Array, precondition: Map, rtol: float = 1e-10, most: int = 500
) -> Step:
    return flexible_conjugate_gradients(
        lambda v: H @ v, side, precondition, rtol, most, None
    )


def wavering(H: Array) -> Map:
    """About H⁻¹, another at every call and not quite linear."""
    inverse, rng = np.linalg.inv(H), np.random.default_rng(9)

    def apply(v: Array) -> Array:
        z = inverse @ v
        return np.asarray(z * (1.0 + 0.1 * rng.uniform(-1.0, 1.0, N)))

    return apply


@pytest.mark.parametrize("how", ["none", "diagonal", "wavering"])
def test_it_solves_to_the_residual_asked_for(how: str) -> None:
    H, side = matrix(), np.random.default_rng(1).normal(size=N)
    own: Map = {
        "none": lambda v: v.copy(),
        "diagonal": lambda v: v / np.diag(H),
        "wavering": wavering(H),
    }[how]
    found = run(H, side, own)
    assert np.linalg.norm(H @ found.d - side) <= 1.1e-10 * np.linalg.norm(side)
    np.testing.assert_allclose(found.d, np.linalg.solve(H, side), rtol=1e-6, atol=1e-9)


def test_a_wavering_preconditioner_costs_few_steps() -> None:
    """Fletcher and Reeves' rule, which asks for a fixed one, needs far more."""
    H, side = matrix(), np.random.default_rng(1).normal(size=N)
    found = run(H, side, wavering(H))
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


def test_with_a_fixed_one_errors_fall_as_those_of_conjugate_gradients() -> None:
    """k steps minimise the energy over the Krylov space."""
    H, side = matrix(condition=50.0), np.random.default_rng(2).normal(size=N)
    exact = np.linalg.solve(H, side)
    krylov = [side]
    for k in range(1, 6):
        found = run(H, side, lambda v: v.copy(), 0.0, k)
        basis, _ = np.linalg.qr(np.array(krylov).T)
        best = basis @ np.linalg.solve(basis.T @ H @ basis, basis.T @ side)
        assert found.steps == k
        np.testing.assert_allclose(found.d, best, atol=1e-8 * np.abs(exact).max())
        krylov.append(H @ krylov[-1])


def test_it_stops_where_it_is_told_to() -> None:
    H, side = matrix(), np.random.default_rng(3).normal(size=N)
    assert run(H, side, lambda v: v, most=0).steps == 0
    late = flexible_conjugate_gradients(
        lambda v: H @ v, side, lambda v: v.copy(), 1e-10, 99, 0.0
    )
    assert late.steps == 0 and not late.d.any()
    none = run(H, np.zeros(N), lambda v: v.copy())
    assert none.steps == 0 and not none.d.any()


def test_a_direction_without_curvature_ends_it() -> None:
    """A semidefinite H: what its rows determine is found, the rest stays at zero."""
    H = np.diag([1.0, 2.0, 0.0])
    found = run(H, np.array([1.0, 1.0, 0.0]), lambda v: v.copy(), 1e-12, 50)
    np.testing.assert_allclose(found.d, [1.0, 0.5, 0.0], atol=1e-12)
    flat = run(np.zeros((3, 3)), np.ones(3), lambda v: v.copy())
    assert flat.steps == 0 and not flat.d.any()
