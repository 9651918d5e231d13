"""The model of the limits that can bind, against dense algebra and all active sets."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from tests.solvers.dual.test_field_pair import contested, coulomb
from tests.solvers.dual.test_pair_subproblem import pair
from tests.solvers.dual.test_pivoting import wrong_signs
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.dual import touched_limits
from ttus_opt.solvers.dual.limits import Multipliers
from ttus_opt.solvers.dual.touched_limits import TouchedLimits, complementary
from ttus_opt.solvers.dual.working_set import WorkingSet
from ttus_opt.solvers.structured import Structured


def model(of):
    V = len(of.limits.given) // 2
    limited = np.isfinite(of.limits.lower[V:]) & ~of.limits.given[V:]
    made = TouchedLimits.of(of.rows, limited)
    assert made is not None
    return made


def dense_response(of, at):
    """Inverse of half the second derivative in x, y and c, from its definition."""
    rows = of.rows
    L = rows.L.toarray()
    free = rows.compliance > 0.0
    root = np.where(free, 1.0 / np.sqrt(np.where(free, rows.compliance, 1.0)), 1e4)
    M = np.vstack(
        [
            root[:, None] * np.column_stack([L, rows.column]),
            rows.root_weights[:, None]
            * np.column_stack([rows.rows.toarray(), rows.measured_column]),
        ]
    )
    return np.asarray(np.linalg.inv(M.T @ M)[np.ix_(at, at)])


@pytest.mark.parametrize(
    ("weight", "smoothness"), [(0.01, 1.0), (1.0, 1.0), (1e4, 1.0), (1e5, 1e4)]
)
def test_response_is_nearly_the_inverse_of_the_second_derivative(weight, smoothness):
    """Nearer than what the first field, which follows, makes of it: 3 and 1 %."""
    of = pair(weight, smoothness, 0.3, False)
    made = model(of)
    n = len(of.limits.given)
    # the unknown beside the fields is the last
    exact = dense_response(of, np.append(made.voxels + n // 2, n))
    # in its own measure: eigenvalues of the exact inverse times the model
    size = np.linalg.eigvals(np.linalg.solve(exact, made.response)).real
    assert size.min() > 0.998
    assert size.max() < 1.03


@pytest.mark.parametrize("at_upper", [False, True])
def test_a_bound_of_the_unknown_beside_is_a_limit_like_others(at_upper):
    """Released or held, as the minimum over two limits by trying all has it."""
    bounds = (0.0, 1.0)
    root = np.array([[2.0, 0.0], [-0.9 if at_upper else 0.9, 1.0]])
    response = root @ root.T
    c, sign = (1.0, -1.0) if at_upper else (0.0, 1.0)
    made = TouchedLimits(np.array([5]), response, bounds)
    for slack, z_y, slope in itertools.product(
        (-0.5, 0.3), (0.0, 0.4), (-0.6, 0.0, 0.8)
    ):
        found = made.active(np.array([slack]), np.array([z_y]), (c, slope))
        turned = response * np.outer([1.0, sign], [1.0, sign])
        constant = np.array([slack, 0.0]) - turned @ [z_y, sign * slope]
        right = [
            active
            for active in itertools.product([False, True], repeat=2)
            if not wrong_signs(turned, constant, np.array(active)).any()
        ]
        assert found.tolist() in [[active[0]] for active in right]


def test_its_voxels_are_those_that_rows_touch_and_limits_leave_open():
    rows = pair(1.0, 1.0, 0.3, False).rows
    V = len(rows.laplace.free)
    touched = np.asarray(abs(rows.rows).sum(axis=0) > 0.0).reshape(-1)
    touched = touched[:V] | touched[V:]
    held, limited = np.flatnonzero(~rows.laplace.free), np.ones(V, dtype=bool)
    limited[np.flatnonzero(touched)[::3]] = False
    assert not touched[held].any()
    # an entry of zero beside them touches nothing, one on the boundary moves nothing
    more = np.zeros((2, 2 * V))
    more[0, np.flatnonzero(rows.laplace.free & ~touched)[0]] = 1.0
    more[1, held[:5]] = 1.0
    added = sp.csr_array(more)
    added.data[0] = 0.0
    stacked = sp.csr_array(sp.vstack([rows.rows, added]))
    assert stacked.nnz == rows.rows.nnz + 6
    weights = np.append(rows.root_weights, [1.0, 1.0])
    column = np.append(rows.measured_column, [0.0, 0.0])
    longer = replace(rows, rows=stacked, root_weights=weights, measured_column=column)
    made = TouchedLimits.of(longer, limited)
    np.testing.assert_array_equal(made.voxels, np.flatnonzero(touched & limited))


def test_a_factor_that_fails_makes_no_model(monkeypatch):
    def fails(*_, **__):
        raise np.linalg.LinAlgError("not positive definite")

    of = pair(1.0, 1.0, 0.3, False)
    monkeypatch.setattr(touched_limits.scipy.linalg, "cholesky", fails)
    assert TouchedLimits.of(of.rows, of.rows.laplace.free) is None


def test_too_many_voxels_or_none_make_no_model(monkeypatch):
    of = pair(1.0, 1.0, 0.3, False)
    V = len(of.limits.given) // 2
    assert TouchedLimits.of(of.rows, np.zeros(V, dtype=bool)) is None
    monkeypatch.setattr(touched_limits, "MOST_VOXELS", 1)
    assert TouchedLimits.of(of.rows, np.ones(V, dtype=bool)) is None


def test_exchanges_of_all_wrong_signs_that_go_round_come_to_an_end():
    """A matrix of rank three, nearly, for which block pivoting alone cycles."""
    rng = np.random.default_rng(7)
    root = rng.normal(size=(6, 3))
    matrix, constant = root @ root.T + 1e-3 * np.eye(6), rng.normal(size=6)
    active = start = rng.random(6) < 0.5
    seen = set()
    while active.tobytes() not in seen:
        seen.add(active.tobytes())
        active = active ^ wrong_signs(matrix, constant, active)
    assert wrong_signs(matrix, constant, active).any()  # never done
    found = complementary(matrix, constant, start)
    assert not wrong_signs(matrix, constant, found).any()


def test_complementary_takes_what_is_nearly_singular_without_a_warning():
    """As the model is at heavy weights; there SciPy's `solve` warns."""
    matrix = scipy.linalg.hilbert(12)
    assert np.linalg.cond(matrix) > 1.0 / np.finfo(float).eps
    found = complementary(matrix, -np.ones(12), np.ones(12, dtype=bool))
    z = np.zeros(12)
    at = np.flatnonzero(found)
    z[at] = np.linalg.solve(matrix[np.ix_(at, at)], np.ones(len(at)))
    assert z.min() >= 0.0
    assert (matrix @ z - 1.0).min() >= -1e-9


def test_complementary_of_a_singular_matrix_is_none():
    matrix = np.ones((3, 3))
    assert complementary(matrix, -np.ones(3), np.ones(3, dtype=bool)) is None


def test_a_model_lost_to_rounding_predicts_nothing(monkeypatch):
    of = pair(1.0, 1.0, 0.3, False)
    n = len(of.limits.given)
    none, below = Multipliers(np.zeros(n), np.zeros(n)), np.full(n, -1.0)
    assert of.predicted(WorkingSet.empty(n), below, none) is not None
    monkeypatch.setattr(touched_limits, "complementary", lambda *_: None)
    assert of.predicted(WorkingSet.empty(n), below, none) is None


def test_a_rough_prediction_does_not_lead_back_to_a_set_that_failed():
    """Solved no more exactly than before, it did: 15 working sets in place of 7."""
    scene = contested(1, noise=0.2, mu=0.0)
    program = coulomb(scene, 1e-4, largest_friction=10.0).compile()
    candidate = Structured().prepare(program, Request(1e-6, None)).solve()
    assert candidate.claim is Claim.DONE
    assert kkt_residuals(program, candidate.x, candidate.duals).worst_relative < 1e-6
    assert int(candidate.detail.split(" ")[0]) <= 10
