"""A recycled subspace of a dense operator: conjugate, exact, kept by new weights."""

from __future__ import annotations

import numpy as np
import pytest

from ttus_opt.core.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.solvers.dual.conjugate_gradients import (
    RecycledSubspace,
    conjugate_gradients,
)
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.dual.options import Accuracy, DualOptions

M = 12


class Dense:
    """S = I + w K w."""

    def __init__(self, w: Array) -> None:
        root = np.random.default_rng(0).normal(size=(M, M)) * 10.0 ** np.linspace(
            -2, 2, M
        )
        self.root_weights, self.calls = w, 0
        self.S = np.eye(M) + w[:, None] * (root @ root.T) * w

    def apply(self, y: Array, rtol: float) -> Array:
        self.calls += 1
        return self.S @ y


def everything(columns: Array | None = None) -> Complement:
    """The whole space, or what lies across some columns; no preconditioner."""
    return Complement(np.zeros((M, 0)) if columns is None else columns, lambda r: r)


def solved(
    subspace: RecycledSubspace, t: Array, space: Complement | None = None, **o: float
) -> tuple[Array, int]:
    options = DualOptions(**o)  # type: ignore[arg-type]
    goal = 1e-10 * float(np.linalg.norm(t))
    space = space or everything()
    return conjugate_gradients(subspace, t, goal, space, Accuracy(1e-10), options)


def test_solves_and_keeps_conjugate_directions() -> None:
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


def test_other_weights_cost_no_product() -> None:
    w = np.linspace(0.5, 2.0, M)
    first, second = Dense(np.ones(M)), Dense(w)
    subspace = RecycledSubspace(first)
    for t in np.eye(M):
        solved(subspace, t)
    subspace.adopt(second)
    t = np.random.default_rng(2).normal(size=M)
    y, rest = subspace.project(t)
    assert second.calls == 0
    np.testing.assert_allclose(second.S @ y, t - rest, atol=1e-8)
    np.testing.assert_allclose(rest, 0.0, atol=1e-6)


def test_across_columns_only_the_rest_counts() -> None:
    E = np.random.default_rng(3).normal(size=(M, 2))
    system, t = Dense(np.ones(M)), np.random.default_rng(4).normal(size=M)
    y, _ = solved(RecycledSubspace(system), t, everything(E))
    full = np.block([[system.S, E], [E.T, np.zeros((2, 2))]])
    expected = np.linalg.solve(full, np.concatenate([t, np.zeros(2)]))[:M]
    np.testing.assert_allclose(y, expected, atol=1e-7)


def test_directions_are_limited_and_nonsense_is_not_kept() -> None:
    subspace = RecycledSubspace(Dense(np.ones(M)))
    _, steps = solved(subspace, np.ones(M), max_directions=3)
    assert steps == len(subspace) == 3
    assert not subspace.extend(np.full(M, np.nan), 0.0)
    assert len(subspace) == 3


@pytest.mark.parametrize("kept_as", [np.float64, np.float32])
def test_a_step_is_the_projection_onto_the_last(kept_as: type) -> None:
    subspace = RecycledSubspace(Dense(np.ones(M)), kept_as)
    rng = np.random.default_rng(5)
    subspace.extend(rng.normal(size=M), 0.0)
    r = rng.normal(size=M)
    for found, expected in zip(subspace.step(r), subspace.project(r), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_the_last_of_no_directions_leaves_all() -> None:
    subspace = RecycledSubspace(Dense(np.ones(M)))
    t = np.random.default_rng(4).normal(size=M)
    y, rest = subspace.step(t)
    assert not y.any()
    np.testing.assert_array_equal(rest, t)


def test_an_image_beyond_single_precision_is_kept_conjugate() -> None:
    system = Dense(np.full(M, 1e20))
    subspace = RecycledSubspace(system, np.float32)
    assert subspace.extend(np.ones(M), 1e-10)  # S d is of the order of 1e40 and more
    d, images = subspace._kept
    assert np.isfinite(images).all()
    assert float(d[0].astype(float) @ images[0]) == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("kept_as", [np.float64, np.float32])
def test_a_vector_is_its_parts_and_a_conjugate_rest(kept_as: type) -> None:
    system = Dense(np.ones(M))
    subspace, rng = RecycledSubspace(system, kept_as), np.random.default_rng(6)
    for direction in rng.normal(size=(5, M)):
        subspace.extend(direction, 0.0)
    y = rng.normal(size=M)
    parts, rest = subspace.parts(y)
    d = subspace.directions.astype(float)
    np.testing.assert_allclose(parts @ d + rest, y, atol=1e-5)
    size = np.sqrt(y @ system.S @ y)
    np.testing.assert_allclose(parts, d @ system.S @ y, atol=1e-5 * size)
    np.testing.assert_allclose(d @ system.S @ rest, 0.0, atol=1e-5 * size)


class Rough(Dense):
    """Products that are off by a thousandth."""

    def apply(self, y: Array, rtol: float) -> Array:
        exact = super().apply(y, rtol)
        noise = np.random.default_rng(self.calls).normal(size=M)
        return exact + 1e-3 * np.linalg.norm(exact) * noise / np.sqrt(M)


def test_of_rough_products_the_rest_is_conjugate_all_the_same() -> None:
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

    def apply(self, y: Array, rtol: float) -> Array:
        return self.S @ y


class Asked(Diagonal):
    """With the accuracy that was asked of each product."""

    def __init__(self) -> None:
        self.rtol: list[float] = []

    def apply(self, y: Array, rtol: float) -> Array:
        self.rtol.append(rtol)
        return super().apply(y, rtol)


def test_products_may_be_rougher_the_smaller_the_residual() -> None:
    """A tenth of the goal over the residual, between two limits; residuals anew."""
    system, t = Asked(), np.random.default_rng(11).normal(size=50)
    goal = 2e-12 * float(np.linalg.norm(t))
    given = everything(np.zeros((50, 0))), Accuracy(1e-10)
    options = DualOptions(loosest_product=1e-5)
    conjugate_gradients(RecycledSubspace(system), t, goal, *given, options)
    left = [np.linalg.norm(t)]
    for k in range(1, len(system.rtol)):
        few = DualOptions(loosest_product=1e-5, max_directions=k)
        y, _ = conjugate_gradients(RecycledSubspace(Diagonal()), t, goal, *given, few)
        left.append(np.linalg.norm(t - Diagonal.S @ y))
    expected = np.clip(0.1 * goal / np.array(left), RTOL, 1e-5)
    np.testing.assert_allclose(system.rtol, expected, rtol=0.01)
    assert (expected == RTOL).any() and (expected == 1e-5).any()
    assert ((expected > 2 * RTOL) & (expected < 5e-6)).sum() > 3


@pytest.mark.parametrize("kept_as", [np.float64, np.float32])
def test_there_is_room_for_any_number_of_directions(kept_as: type) -> None:
    """One for each eigenvalue, and none is lost as the store grows."""
    subspace = RecycledSubspace(Diagonal(), kept_as)
    for direction in np.random.default_rng(9).normal(size=(50, 50)):
        assert subspace.extend(direction, 0.0)
    d, images = subspace._kept
    assert len(subspace) == 50
    np.testing.assert_allclose(d @ images.T, np.eye(50), atol=1e-5)
    t = np.random.default_rng(10).normal(size=50)
    y, rest = subspace.project(t)
    np.testing.assert_allclose(Diagonal.S @ y, t, atol=1e-4)
    assert np.abs(rest).max() < 1e-4


def test_nothing_to_solve_takes_no_step() -> None:
    subspace = RecycledSubspace(Dense(np.ones(M)))
    y, steps = solved(subspace, np.zeros(M))
    assert not y.any() and steps == len(subspace) == 0


def test_dependent_directions_are_dropped_with_other_weights() -> None:
    subspace, rng = RecycledSubspace(Dense(np.ones(M))), np.random.default_rng(7)
    for direction in rng.normal(size=(3, M)):
        subspace.extend(direction, 0.0)
    subspace._store[:, 3:5], subspace._count = subspace._store[:, 1:3], 5
    second = Dense(np.linspace(0.5, 2.0, M))
    subspace.adopt(second)
    assert len(subspace) == 3
    gram = subspace.directions @ second.S @ subspace.directions.T
    np.testing.assert_allclose(gram, np.eye(3), atol=1e-8)
