"""A reduced basis for many weights: its minimisers against a direct factorisation."""

import time

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from tests.kit import small_scene
from ttus_opt.problem.formulation import load
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.dual import options, weight_sweep
from ttus_opt.solvers.dual.data import DualData, duals_without_limits, root_weights

WEIGHTS = ((1e-4, 1e-4), (1.0, 1e-2), (1e2, 1e2), (1e-3, 10.0))


def declared(name="eq10", force=1.0, torque=1.0):
    scene = small_scene("trilinear")
    return load(name, scene).with_weights(force=force, torque=torque)


def exact(program):
    """The minimiser over the voxels that no equality holds, by a factorisation."""
    Q, d = program.normal_equations()
    given = program.dirichlet
    if given is None:
        return np.asarray(spsolve(Q, d))
    free = program.laplace.free
    x = np.zeros(len(d))
    x[~free] = given.lower
    Q = sp.csc_array(Q)
    x[free] = spsolve(sp.csc_array(Q[free][:, free]), (d - Q @ x)[free])
    return x


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eq10", "eq10_hard_boundary", "volume_weighted"])
def test_minimisers_are_those_of_a_factorisation(name):
    sweep = weight_sweep.WeightSweep(DualData.of(declared(name).compile()))
    for force, torque in WEIGHTS:
        program = declared(name, force, torque).compile()
        answer = sweep.solve(root_weights(program), 1e-8)
        x = exact(program)
        assert answer.settled
        assert np.abs(answer.p - x).max() < 1e-7 * np.abs(x).max()
        kkt = kkt_residuals(program, answer.p, duals_without_limits(program, answer.p))
        assert kkt.worst_relative < 1e-7


def test_what_was_solved_needs_nothing_new():
    sweep = weight_sweep.WeightSweep(DualData.of(declared().compile()))
    roots = [root_weights(declared("eq10", *pair).compile()) for pair in WEIGHTS]
    first = [sweep.solve(root, 1e-6).directions for root in roots]
    assert min(first) > 0 and len(sweep) == sum(first)
    assert [sweep.solve(root, 1e-6).directions for root in roots] == [0] * len(roots)


def test_the_basis_is_orthonormal_and_its_error_is_what_it_says():
    """Loosely solved, the objective is above its minimum by the square asked for."""
    program = declared().compile()
    sweep = weight_sweep.WeightSweep(DualData.of(program))
    least = program.objective(exact(program))
    for rtol in (1e-1, 1e-2, 1e-3):
        found = program.objective(sweep.solve(root_weights(program), rtol).p)
        # a V-cycle stands for the solves in the estimate
        assert found - least < 2.0 * rtol**2 * found
    energy = sweep._multipliers @ sweep.images.T
    assert np.abs(energy - np.eye(len(sweep))).max() < 1e-8


def test_a_deadline_ends_it():
    program = declared().compile()
    sweep = weight_sweep.WeightSweep(DualData.of(program))
    answer = sweep.solve(root_weights(program), 1e-6, time.perf_counter() - 1.0)
    assert not answer.settled and answer.directions == 0
    p0 = program.laplace.solve(declared().scene.b)
    np.testing.assert_allclose(answer.p, p0, atol=1e-9)


def test_fields_that_are_handed_over_have_the_images_that_stay():
    """At some voxels alone, in blocks, in single precision."""
    program = declared("eq10", 30.0, 30.0).compile()
    data, scene = DualData.of(program), declared().scene
    voxels = np.unique(data.system.rows.indices)
    sweep = weight_sweep.WeightSweep(data, voxels=voxels)
    sweep.complete(root_weights(program))
    assert (
        weight_sweep.BLOCK < len(sweep) < scene.n_voxels
        and len(sweep) % weight_sweep.BLOCK
    )
    fields = sweep.take_fields().astype(float)
    assert fields.shape == (len(sweep), len(voxels))
    images = fields @ data.system.rows[sweep.informative][:, voxels].T
    size = np.abs(sweep.images).max()
    np.testing.assert_allclose(images, sweep.images, atol=1e-5 * size)


def test_with_a_direction_for_every_row_the_basis_is_complete():
    """One pose: fewer rows than `PROBES`, whose mean would else end it."""
    scene = small_scene("trilinear", n_poses=1)
    data = DualData.of(load("eq10", scene).without("torque").compile())
    sweep = weight_sweep.WeightSweep(data)
    assert sweep.complete(data.system.root_weights, 1e-12)
    assert len(sweep) == 3 < weight_sweep.PROBES
    G = np.linalg.solve(scene.L.toarray().T, data.system.rows.toarray().T)
    C = G.T @ G
    size = np.abs(C).max()
    np.testing.assert_allclose(sweep.images.T @ sweep.images, C, atol=1e-6 * size)


def test_a_combination_may_be_of_fewer_fields_than_are_held():
    """As after a solve whose best point came before its last directions."""
    program = declared("eq10", 30.0, 30.0).compile()
    data, rng = DualData.of(program), np.random.default_rng(0)
    sweep = weight_sweep.WeightSweep(data)
    sweep.complete(root_weights(program))
    rows = data.system.rows[sweep.informative]
    assert len(sweep) > weight_sweep.BLOCK + 1
    for k in (0, 3, weight_sweep.BLOCK, weight_sweep.BLOCK + 1):
        c = rng.normal(size=k)
        found, expected = rows @ sweep._combined(c), c @ sweep.images[:k]
        size = np.abs(sweep.images).max()
        np.testing.assert_allclose(found, expected, atol=1e-6 * size)


def test_too_few_directions_complete_nothing(monkeypatch):
    monkeypatch.setattr(options, "MAX_DIRECTIONS", 3)
    program = declared("eq10", 30.0, 30.0).compile()
    sweep = weight_sweep.WeightSweep(DualData.of(program))
    assert not sweep.complete(root_weights(program))
    assert len(sweep) == 3


def test_completed_it_holds_all_that_the_rows_tell_of_each_other():
    """KᵀK against C from dense inverses, in the trace that was asked for."""
    program = declared("eq10", 30.0, 30.0).compile()
    data = DualData.of(program)
    sweep = weight_sweep.WeightSweep(data)
    root = root_weights(program)
    assert sweep.complete(root, missing=0.1)
    D = data.system.rows.toarray()[sweep.informative]
    G = np.linalg.solve(program.laplace.L.toarray().T, D.T)
    rest = G.T @ G - sweep.images.T @ sweep.images
    assert -1e-6 < (root[sweep.informative] ** 2 * np.diag(rest)).sum() < 0.3
    before = len(sweep)
    assert sweep.solve(root, 1e-5).settled and len(sweep) - before < 5


@pytest.mark.parametrize("field_rtol", [1e-6, 1e-8])
def test_dependent_rows_are_spanned_and_nothing_is_added(field_rtol):
    """Four frames beside each other tell twelve things of the field, not 24."""
    scene = small_scene("trilinear", shape=(5, 8, 6), n_poses=4)
    data = DualData.of(load("eq10", scene).compile())
    root, D = data.system.root_weights, data.system.rows.toarray()
    G = np.linalg.solve(scene.L.toarray().T, D.T)
    C = G.T @ G
    rank = int(np.linalg.matrix_rank(C, tol=1e-11 * np.abs(C).max()))
    sweep = weight_sweep.WeightSweep(data, field_rtol=field_rtol)
    assert sweep.complete(root, 1e-12)
    assert len(sweep) <= rank < len(root)
    K = sweep.images
    np.testing.assert_allclose(K.T @ K, C, atol=1e-6 * np.abs(C).max())
