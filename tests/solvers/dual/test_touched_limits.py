"""The model of the limits that can bind, against dense algebra and all active sets."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.solvers.dual.test_field_pair import contested, coulomb
from tests.solvers.dual.test_pair_subproblem import pair
from ttus_opt.arrays import Array
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.dual import touched_limits
from ttus_opt.solvers.dual.field_pair import FieldPair
from ttus_opt.solvers.dual.touched_limits import TouchedLimits, complementary
from ttus_opt.solvers.structured import Structured


def model(of: FieldPair) -> TouchedLimits:
    V = len(of.limits.given) // 2
    limited = np.isfinite(of.limits.lower[V:]) & ~of.limits.given[V:]
    made = TouchedLimits.of(of.rows, limited)
    assert made is not None
    return made


def dense_response(of: FieldPair, at: Array) -> Array:
    """Inverse of half the second derivative in x, y and c, from its definition."""
    rows = of.rows
    free = rows.compliance > 0.0
    root = np.where(free, 1.0 / np.sqrt(np.where(free, rows.compliance, 1.0)), 1e4)
    M = np.vstack(
        [
            root[:, None] * np.column_stack([rows.L.toarray(), rows.column]),
            rows.root_weights[:, None]
            * np.column_stack([rows.rows.toarray(), rows.measured_column]),
        ]
    )
    return np.asarray(np.linalg.inv(M.T @ M)[np.ix_(at, at)])


@pytest.mark.parametrize("weight", [0.01, 1.0, 100.0])
def test_response_is_nearly_the_inverse_of_the_second_derivative(weight: float) -> None:
    of = pair(weight, 1.0, 0.3, False)
    made = model(of)
    exact = dense_response(of, made.voxels + len(of.limits.given) // 2)
    # in its own measure: eigenvalues of the exact inverse times the model
    size = np.linalg.eigvals(np.linalg.solve(exact, made.response)).real
    assert size.min() > 0.9
    assert size.max() < 1.1


def test_too_many_voxels_or_none_make_no_model(monkeypatch: pytest.MonkeyPatch) -> None:
    of = pair(1.0, 1.0, 0.3, False)
    V = len(of.limits.given) // 2
    assert TouchedLimits.of(of.rows, np.zeros(V, dtype=bool)) is None
    monkeypatch.setattr(touched_limits, "MOST_VOXELS", 1)
    assert TouchedLimits.of(of.rows, np.ones(V, dtype=bool)) is None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("tries", [0, 10])
def test_complementary_is_the_one_set_without_wrong_signs(
    seed: int, tries: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(touched_limits, "TRIES", tries)
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    matrix, constant = root @ root.T + 1e-3 * np.eye(6), rng.normal(size=6)
    right = []
    for active in itertools.product([False, True], repeat=6):
        at = np.flatnonzero(active)
        z = np.zeros(6)
        z[at] = np.linalg.solve(matrix[np.ix_(at, at)], -constant[at])
        rest = np.where(active, z, matrix @ z + constant)
        if (rest >= 0.0).all():
            right.append(np.array(active))
    (only,) = right
    found = complementary(matrix, constant, rng.random(6) < 0.5)
    np.testing.assert_array_equal(found, only)


def test_model_leads_to_the_same_answer_in_fewer_working_sets(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = contested(1, noise=0.2, mu=0.0, shape=(8, 16, 8))
    program = coulomb(scene, 1.0, largest_friction=10.0).compile()
    with_model = Structured().prepare(program, Request(1e-7, None)).solve()
    monkeypatch.setattr(FieldPair, "predicted", lambda *_: None)
    without = Structured().prepare(program, Request(1e-7, None)).solve()
    assert with_model.x is not None and without.x is not None
    assert with_model.claim is without.claim is Claim.DONE
    size = np.abs(without.x).max()
    np.testing.assert_allclose(with_model.x, without.x, rtol=0.0, atol=1e-6 * size)
    sets = [int(found.detail.split(" ")[0]) for found in (with_model, without)]
    assert sets[0] < sets[1]
