"""The bound on what a dual residual leaves open, against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import dragged_scene, small_scene
from tests.solvers.problems import program as bare
from tests.solvers.problems import rows, term
from ttus_opt.problem.formulation import load
from ttus_opt.problem.verify.distance import CLOSE, energy, field_of, held_by_equalities
from ttus_opt.problem.verify.kkt import Duals, kkt_residuals
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.registry import solvers

SCENE = small_scene("trilinear", shape=(6, 12, 7), n_poses=6)


def sliding():
    return dragged_scene("contact", mu=0.2, viscous=30.0, shape=(6, 9, 7))


def compiled(name, **options):
    scene = sliding() if "drag" in name else SCENE
    return load(name, scene, **options).compile()


def dense(program, r, fixed):
    """½ rᵀP⁻¹r over what is free to move."""
    P = np.zeros((program.n_variables, program.n_variables))
    for member in program.terms:
        if member.is_squares:
            M = member.matrix.toarray()
            P += 2.0 * member.weight * M.T @ M
    free = ~fixed
    return 0.5 * float(r[free] @ np.linalg.solve(P[np.ix_(free, free)], r[free]))


@pytest.mark.slow
@pytest.mark.parametrize("weight", [1e-4, 10.0])
@pytest.mark.parametrize(
    "name",
    [
        "eq10",
        "eq10_sign",
        "eq10_hard_boundary",
        "viscous_drag",
        "coulomb_drag",
        "screened",
        "anisotropic",
        "tikhonov",
        "volume_weighted",
        "free_surface",
        "robust",
    ],
)
def test_a_bound_that_is_close(name, weight):
    program = compiled(name, force_weight=weight, torque_weight=weight)
    fixed = held_by_equalities(program)
    assert fixed.any() == (name in ("eq10_hard_boundary", "volume_weighted"))
    rng = np.random.default_rng(1)
    for r in (rng.normal(size=len(fixed)), program.gradient_at_zero()):
        truth = dense(program, r, fixed)
        bound = energy(program, r, fixed)
        if bound is None:  # only where all of it has to be solved for
            assert name in ("free_surface", "screened", "anisotropic")
            continue
        assert bound >= truth * (1.0 - 1e-6)
        # beside parameters the bound is a true one, not a close one
        if "drag" not in name:
            assert bound <= truth * (1.0 + 1.5 * CLOSE)
        loose = energy(program, r, fixed, enough=100.0 * truth)
        assert loose >= truth * (1.0 - 1e-6)


@pytest.mark.parametrize("weight", [1e-4, 10.0])
@pytest.mark.parametrize("name", ["viscous_drag", "coulomb_drag"])
def test_the_bound_beside_parameters_holds_for_the_worst_residuals(name, weight):
    """Over a parameter alone, and what the weakest directions make of both parts."""
    program = compiled(name, force_weight=weight, torque_weight=weight)
    free = ~held_by_equalities(program)
    assert free.all()
    P = sum(2.0 * t.weight * (t.matrix.T @ t.matrix).toarray() for t in program.terms)
    inverse = np.linalg.inv(P)
    (at,) = [v.start for v in program.variables.values() if v.stop - v.start == 1]
    unit = np.zeros(len(free))
    unit[at] = 1.0
    weakest = np.linalg.eigh(P)[1][:, :4]
    mixed = [unit * size + P @ v for v in weakest.T for size in (1.0, -1.0)]
    steered = inverse[:, at] / inverse[at, at]  # x that the parameter drags along
    aside = steered - unit * steered[at]
    others = [P @ steered, steered, steered - 2.0 * unit * steered[at]]
    others += [unit + sign * aside / (aside @ aside) for sign in (1.0, -1.0)]
    for r in (unit, *mixed, *others):
        bound = energy(program, r, ~free)
        assert bound >= 0.5 * float(r @ inverse @ r) * (1.0 - 1e-6)


def test_rows_of_free_voxels_alone_determine_a_field_only_with_the_others_fixed():
    laplace = SCENE.laplace
    V = len(laplace.free)
    none, given = np.zeros(V, dtype=bool), ~laplace.free
    own = next(t for t in compiled("volume_weighted").terms if t.laplace_rows)
    assert len(own.target) < V
    assert field_of(own, "p", slice(0, V), none, laplace) is None
    assert field_of(own, "p", slice(0, V), given, laplace) is not None
    whole = next(t for t in compiled("eq10").terms if t.laplace_rows)
    scaled = replace(whole, tags=frozenset({tt.terms.LaplaceRows("p", np.ones(V))}))
    for term_of_all in (whole, scaled):
        assert field_of(term_of_all, "p", slice(0, V), none, laplace) is not None


def test_nothing_is_said_where_squares_leave_something_open():
    """Sparse sources: only the measured rows are squares; and a row too few."""
    program = compiled("sparse_sources", force_weight=0.1)
    r = np.random.default_rng(0).normal(size=program.n_variables)
    assert energy(program, r, held_by_equalities(program)) is None
    free = np.zeros(2, dtype=bool)
    one = bare([term([[1.0, 0.0]], [1.0])])
    assert energy(one, np.array([1.0, 1e-9]), free) is None
    told = energy(one, np.array([1.0, 0.0]), free)
    assert 0.25 <= told <= 0.25 * (1.0 + 1.01 * CLOSE)
    tied = bare([term([[1.0, 1.0]], [1.0])])
    assert energy(tied, np.array([1.0, -1.0]), free) is None
    assert energy(one, np.zeros(2), free) == 0.0
    nothing = bare([term([[1.0, 0.0]], [1.0], penalty=tt.terms.Linear())])
    assert energy(nothing, np.array([1.0, 0.0]), free) is None


def test_rows_that_fix_a_variable():
    limits = [
        rows("one", [[2, 0, 0], [0, 1, 1]], [4, 1], [4, 1]),
        rows("range", [[0, 0, 1]], [0], [1]),
    ]
    program = bare([term(np.eye(3), [0, 0, 0])], limits)
    np.testing.assert_array_equal(held_by_equalities(program), [True, False, False])


@pytest.mark.parametrize("name", ["eq10", "eq10_sign", "viscous_drag"])
def test_the_gap_bounds_how_far_a_wrong_answer_lies(name):
    """Both statements of the module, on perturbed answers."""
    program = compiled(name, force_weight=1.0, torque_weight=1.0)
    answer = solvers()["structured"].prepare(program, Request(1e-10)).solve()
    least = program.objective(answer.x)
    rng = np.random.default_rng(2)
    for size in (1e-6, 1e-3, 1e-1):
        x = answer.x * (1.0 + size * rng.normal(size=len(answer.x)))
        kkt = kkt_residuals(program, x, answer.duals)
        excess = program.objective(x) - least
        assert excess <= kkt.gap * (1.0 + 1e-6) + 1e-12 * least
        apart = sum(
            t.weight * float(np.sum((t.matrix @ (x - answer.x)) ** 2))
            for t in program.terms
        )
        assert apart <= 1.01 * kkt.distance**2
    assert (
        kkt_residuals(program, answer.x, Duals(bounds=answer.duals.bounds)).gap < 1e-9
    )
