"""Few rows by their dual, as its equations ask, whatever is kept of directions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from tests.solvers.own_terms import AlongZ
from tests.solvers.primal.test_limited_sum import made
from ttus_opt.solvers.primal import preconditioner as module
from ttus_opt.solvers.primal.least_squares import preconditioner
from ttus_opt.solvers.primal.preconditioner import (
    ConstraintPreconditioner,
    with_few_rows,
)

#: Unknowns of a dense problem
N = 40


def fresh():
    _, problem = made(AlongZ, False)
    split = problem.split
    columns = np.ones(split.few.columns.shape[1], dtype=bool)
    built = preconditioner(split, columns)
    rng = np.random.default_rng(2)
    return built, rng.normal(size=len(split.few.b) + len(split.few.t))


def test_fields_kept_of_directions_stand_for_solves(monkeypatch):
    kept, rest = fresh()
    system, spent = kept._system, []
    own = type(system).response

    def counted(self, y, *more):
        spent.append(1)
        return own(system, y, *more)

    monkeypatch.setattr(type(system), "response", counted)
    first = kept(rest)
    known = len(kept._responses.kept)
    assert known == len(kept._subspace) > 0
    assert len(spent) == known  # those of the products, and none for the step
    spent.clear()
    again = kept(rest)
    assert not spent
    m = len(system.root_weights)
    size = np.abs(first[:-m]).max()
    np.testing.assert_allclose(again[:-m], first[:-m], atol=1e-6 * size)
    expected = system.prior(rest[:-m]) + own(system, again[-m:])
    size = np.abs(expected).max()
    np.testing.assert_allclose(again[:-m], expected, atol=1e-5 * size)


def test_a_step_obeys_the_equations_beside_free_unknowns():
    """D z + E c + y = s for some c, and Eᵀy = 0; z = P⁻¹(r + Dᵀy) is the test above."""
    built, rest = fresh()
    system = built._system
    m = len(system.root_weights)
    columns = np.random.default_rng(5).normal(size=(m, 2))
    own = ConstraintPreconditioner(system, columns, 1e-9)
    step = own(rest)
    y, size = step[-m:], np.linalg.norm(rest[-m:])
    left = system.measure(step[:-m]) + y - rest[-m:]
    left -= columns @ np.linalg.lstsq(columns, left)[0]
    assert np.linalg.norm(left) <= 1e-6 * size
    assert np.linalg.norm(columns.T @ y) <= 1e-10 * size
    assert np.linalg.norm(y) > 0.1 * size
    assert own.description == f"{len(own._subspace)} directions of the dual"


def test_without_few_rows_the_field_s_part_is_all():
    built, rest = fresh()
    system = built._system
    none = replace(system, rows=sp.csr_array(system.rows.shape))
    m = len(system.root_weights)
    step = ConstraintPreconditioner(none, np.empty((m, 0)), 0.1)(rest)
    np.testing.assert_array_equal(step[:-m], none.prior(rest[:-m]))
    np.testing.assert_array_equal(step[-m:], rest[-m:])


def test_multipliers_beside_the_directions_are_solved_for():
    built, rest = fresh()
    built(rest)
    other = np.random.default_rng(6).normal(size=len(built._system.root_weights))
    expected = built._system.response(other)
    size = np.abs(expected).max()
    np.testing.assert_allclose(built._response(other), expected, atol=1e-9 * size)


@pytest.mark.parametrize("most", [0, 1])
def test_of_many_directions_no_fields_are_kept(most, monkeypatch):
    monkeypatch.setattr(module, "MOST_FIELDS", most)
    built, rest = fresh()
    columns = np.empty((len(built._system.root_weights), 0))
    exact = ConstraintPreconditioner(built._system, columns, 1e-9)
    exact(rest)
    assert len(exact._subspace) > most and not exact._responses.kept


@pytest.mark.parametrize("weight", [1e-3, 1.0, 1e6])
def test_few_rows_of_any_weight_are_added(weight):
    """Woodbury's formula: after all directions (P + DᵀD)⁻¹ itself."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(N, N)) / np.sqrt(N)
    P = root @ root.T + np.eye(N)
    inverse = np.linalg.inv(P)
    D = np.sqrt(weight) * rng.normal(size=(4, N))
    made = with_few_rows(lambda v: inverse @ v, sp.csr_array(D))
    exact = np.linalg.inv(P + D.T @ D)
    for _ in range(12):  # each adds a direction or none
        made(rng.normal(size=N))
    v = rng.normal(size=N)
    found, expected = made(v), exact @ v
    # in the energy norm: what module.INNER allows
    error, H = found - expected, P + D.T @ D
    assert error @ H @ error <= (2.0 * module.INNER) ** 2 * (expected @ H @ expected)
