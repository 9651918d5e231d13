"""Working sets of two fields against dense least squares over what moves on them."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import lstsq

from tests.kit import dragged_scene, with_wrenches
from ttus_opt.laplace.system import BlockSystem
from ttus_opt.problem import formulation
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.solvers.dual.field_pair import FieldPair
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.dual.working_set import WorkingSet

INF = np.inf


@functools.cache
def pair(weight, smoothness, share, hard):
    """Two hundred voxels, and measurements that do not fit the prior."""
    scene = dragged_scene("contact", shape=(5, 8, 5))
    noise = np.random.default_rng(1).normal(0.0, 1.0, scene.f.shape)
    scene = with_wrenches(scene, scene.f + noise)
    declared = formulation.load(
        "coulomb_drag",
        scene,
        force_weight=weight,
        torque_weight=weight,
        smoothness=smoothness,
        largest_friction=share,
    )
    if hard:
        declared = declared.with_constraints(HardBoundary(scene))
    return FieldPair.of(declared.compile())


def active(of, held, linked, seed):
    """Parts of the bounds and links, at random."""
    rng = np.random.default_rng(seed)
    limits = of.limits
    bounded = np.isfinite(limits.lower) & ~limits.given
    bounded[: len(bounded) // 2] = False
    bounds = np.where(bounded & (rng.random(len(bounded)) < held), -1, 0)
    links = np.isfinite(limits.least)
    # at most one of two linked voxels is held
    half = len(links) // 2
    links[:half] &= ~limits.given[:half] | (bounds[half:] == 0)
    links &= rng.random(len(links)) < linked
    return WorkingSet(bounds.astype(np.int8), links)


def dense_answer(of, active):
    """Minimiser of a working set from its definition, entry by entry.

    Unknowns: one per entry that is neither held nor linked, and the mean coefficient
    where its bounds leave it; given rows weigh so much that they hold.
    """
    rows, limits = of.rows, of.limits
    n = len(rows.b)
    V = n // 2
    value = np.full(n, np.nan)
    value[active.bounds < 0] = limits.lower[active.bounds < 0]
    given = np.where(limits.given, limits.lower, np.nan)
    stands = np.arange(n)
    for v in np.flatnonzero(active.links[:V]):
        ends = np.array([v, v + V])
        known = np.where(np.isnan(value[ends]), given[ends], value[ends])
        known = known[~np.isnan(known)]
        if len(known):
            value[ends] = known[0]
        else:
            stands[v + V] = v
    P = np.zeros((n, n))
    moves = np.isnan(value)
    P[np.flatnonzero(moves), stands[moves]] = 1.0
    P = P[:, P.any(axis=0)]
    o = np.where(moves, 0.0, value)
    soft = rows.compliance > 0.0
    root = np.full(n, 1e4)
    root[soft] = 1.0 / np.sqrt(rows.compliance[soft])
    L = rows.L.toarray()
    M = np.vstack(
        [root[:, None] * (L @ P), rows.root_weights[:, None] * (rows.rows @ P)]
    )
    E = np.vstack([root[:, None] * rows.column[:, None], rows.measured_column[:, None]])
    t = np.concatenate(
        [root * (rows.b - L @ o), rows.t - rows.root_weights * (rows.rows @ o)]
    )
    low, high = of.bounds
    z = lstsq(np.hstack([M, E]), t, lapack_driver="gelsy")[0]
    c = np.clip(z[-1:], low, high)  # one number: clipped is best
    return P @ lstsq(M, t - E @ c, lapack_driver="gelsy")[0] + o, c


KINDS = {
    "none": (0.0, 0.0),
    "bounds": (0.3, 0.0),
    "all bounds": (1.0, 0.0),
    "links": (0.0, 0.3),
    "all links": (0.0, 1.0),
    "both": (0.3, 0.3),
    "both everywhere": (0.1, 1.0),
}


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("kind", KINDS)
def test_equals_dense_least_squares(kind, hard):
    for weight, smoothness, share in ((1.0, 1.0, 0.1), (0.1, 30.0, 1.0)):
        of = pair(weight, smoothness, share, hard)
        own = active(of, *KINDS[kind], seed=3)
        expected, c = dense_answer(of, own)
        found = of.subproblem(own).solve(Accuracy(1e-11), None).p
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
        assert of.variables(found)[of.others] == pytest.approx(c, abs=1e-6)


def test_the_best_beside_two_fields_is_that_of_least_squares():
    """Between its bounds; 0, or the bound next to it, where nothing tells."""
    rows = replace(pair(1.0, 1.0, 1.0, hard=True).rows, bounds=(-INF, INF))
    x = np.random.default_rng(4).normal(size=len(rows.b))
    soft = rows.compliance > 0.0
    root = 1.0 / np.sqrt(rows.compliance[soft])
    L = rows.L
    E = np.concatenate([root * rows.column[soft], rows.measured_column])
    misfit = np.concatenate(
        [root * (rows.b - L @ x)[soft], rows.t - rows.root_weights * (rows.rows @ x)]
    )
    best = float(np.linalg.lstsq(E[:, None], misfit)[0][0])
    c, slope = rows.parameter_and_slope(x)
    assert c == pytest.approx(best) and slope == 0.0
    above = replace(rows, bounds=(best + 0.5, INF))
    c, slope = above.parameter_and_slope(x)
    assert c == best + 0.5
    assert slope == pytest.approx(E @ (E * c - misfit))
    silent = replace(rows, column=0.0 * rows.column, measured_column=0.0 * rows.t)
    for bounds, nearest in (((-INF, INF), 0.0), ((0.2, 2.0), 0.2), ((-3.0, -1.0), -1)):
        assert replace(silent, bounds=bounds).parameter(x) == nearest


def system_of(of, own):
    laplace = of.subproblem(own)._solver.system.laplace
    assert isinstance(laplace, BlockSystem)
    return laplace


def test_solves_and_adjoint_solves_belong_together():
    of = pair(1.0, 1.0, 0.1, False)
    laplace = system_of(of, active(of, 0.2, 0.4, seed=5))
    assert laplace.multigrid.across.nnz > 0
    moved = laplace.free
    g, h = np.random.default_rng(2).normal(size=(2, len(moved))) * moved
    there = float(h @ laplace.solve(g))
    assert there == pytest.approx(float(laplace.solve_adjoint(h) @ g), rel=1e-9)


def test_one_cycle_is_near_the_solve_and_has_an_adjoint():
    of = pair(1.0, 1.0, 0.1, False)
    laplace = system_of(of, active(of, 0.2, 0.4, seed=5))
    voxels = np.flatnonzero(laplace.free)
    cycle = laplace.multigrid.preconditioner(voxels)
    assert np.array_equal(cycle.free, laplace.free)
    places = cycle.places(voxels)
    g, h = np.random.default_rng(2).normal(size=(2, len(laplace.free))) * laplace.free

    def once(run, values):
        cycle.b.fill(0.0)
        cycle.b[places] = values[voxels]
        getattr(cycle, run)()
        out = np.zeros_like(values)
        out[voxels] = cycle.x[places]
        return out

    there, back = once("run", g), once("run_adjoint", h)
    assert float(h @ there) == pytest.approx(float(back @ g), rel=1e-4)
    exact = laplace.multigrid.solve(g, rtol=1e-10).x
    assert np.linalg.norm(there - exact) < 0.3 * np.linalg.norm(exact)
