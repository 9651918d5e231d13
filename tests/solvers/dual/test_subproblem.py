"""Subproblems against direct least squares over P z + o, and their multipliers."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

import ttus_opt as tt
from tests.kit import ellipsoid, presses
from tests.oracles.dense import least_squares, stacked
from tests.solvers.dual.user_limits import INF, Within, contested, eq10, louder
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.optimality import multipliers
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.dual.subproblem import reduced
from ttus_opt.solvers.dual.working_set import WorkingSet


def random_limits(scene, seed, hard):
    """Random bounds on every voxel and links along all spokes of the inside."""
    rng = np.random.default_rng(seed)
    V = scene.n_voxels
    lower, upper = rng.uniform(-1.0, 0.0, V), rng.uniform(0.0, 1.0, V)
    if hard:
        lower[~scene.laplace.free], upper[~scene.laplace.free] = -INF, INF
    constraints = [Within(scene, lower, upper), tt.constraints.Monotone(scene, 4.0)]
    if hard:
        constraints.append(tt.constraints.HardBoundary(scene))
    return constraints


def limited(scene, seed, hard, weight=1.0):
    """Eq. 10 under random limits."""
    return eq10(scene, weight, *random_limits(scene, seed, hard)).compile()


def blocks(limits, links):
    """Which pooled block a voxel belongs to, from the graph of links."""
    n = len(links)
    linked = np.flatnonzero(links)
    graph = sp.coo_array(
        (np.ones(len(linked)), (linked, linked + limits.stride)), shape=(n, n)
    )
    return connected_components(graph, directed=False)[1]


def random_working_set(limits, seed, held, linked):
    """Links and bounds at random; at most one bound or given value a block."""
    rng = np.random.default_rng(seed)
    n = len(limits.lower)
    links = np.isfinite(limits.least) & (rng.random(n) < linked)
    label = blocks(limits, links)
    while True:  # links between two given values are cut
        count = np.bincount(label, limits.given)
        crowded = links & (count[label] > 1)
        if not crowded.any():
            break
        links[np.flatnonzero(crowded)[0]] = False
        label = blocks(limits, links)
    bounds = np.zeros(n, dtype=np.int8)
    taken = np.bincount(label, limits.given, minlength=n) > 0
    for v in rng.permutation(n)[: int(held * n)]:
        if not taken[label[v]]:
            bounds[v] = rng.choice([-1, 1])
            taken[label[v]] = True
    return WorkingSet(bounds, links)


def eliminated(program, limits, active):
    """The minimiser: constraints eliminated, the augmented system solved.

    Every block has one unknown unless it has a value; offsets come from walking the
    links, nothing is shared with `subproblem`.
    """
    n = len(active.bounds)
    label = blocks(limits, active.links)
    depth = np.zeros(n)
    for v in range(n):  # from the inside out
        if active.links[v]:
            depth[v + limits.stride] = depth[v] - limits.least[v]
    level = np.full(label.max() + 1, np.nan)
    value = np.where(active.bounds > 0, limits.upper, limits.lower)
    for v in np.flatnonzero((active.bounds != 0) | limits.given):
        level[label[v]] = value[v] - depth[v]
    known = ~np.isnan(level[label])
    offset = depth + np.where(known, level[label], 0.0)
    number = np.cumsum(np.isnan(level)) - 1
    open_ = np.flatnonzero(~known)
    P = sp.csc_array(
        (np.ones(len(open_)), (open_, number[label[open_]])), shape=(n, number[-1] + 1)
    )
    M, t = stacked(program)
    if not P.shape[1]:
        return offset
    return np.asarray(P @ least_squares(sp.csc_array(M @ P), t - M @ offset) + offset)


def solved(program, limits, active):
    data = DualData.of(program)
    left = reduced(limits, active, data)
    return left.solve(Accuracy(1e-12)).p


def compare(scene, seed, hard, weight=1.0):
    program = limited(scene, seed, hard, weight)
    limits = SpokeLimits.of(program)
    for k, (held, linked) in enumerate(
        [(0.1, 0.0), (0.0, 0.3), (0.1, 0.5), (0.6, 0.9), (0.0, 1.0)]
    ):
        active = random_working_set(limits, seed + k, held, linked)
        expected = eliminated(program, limits, active)
        found = solved(program, limits, active)
        apart = np.linalg.norm(found - expected)
        assert apart <= 1e-8 * np.linalg.norm(expected), (held, linked)


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
@pytest.mark.parametrize("seed", [0, 1])
def test_equals_eliminated_least_squares(seed, sampling, hard):
    compare(contested(seed, (8, 13, 7), sampling=sampling), seed, hard)


@pytest.mark.parametrize("weight", [1e-6, 100.0])
def test_equals_eliminated_least_squares_at_other_weights(weight):
    compare(contested(2), 2, False, weight)


def shaped(surface, shape, r_outer):
    """A scene on a surface that breaks careless solvers."""
    voxmap = tt.Voxmap.from_surface(surface, shape=shape, r_inner=0.03, r_outer=r_outer)
    shell = ellipsoid()
    trajectory = presses(surface, 8, np.random.default_rng(2), depth=0.015)
    return louder(
        tt.Scene.assemble(voxmap, shell, trajectory, inner=1.0, sampling="trilinear"),
        seed=2,
    )


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("seed", range(2))
def test_multipliers_solve_the_dense_balance(seed, hard):
    """Cᵀμ = -g, a row of C per active limit or given value; C has full rank."""
    program = limited(contested(seed, (6, 10, 5), n_poses=5), seed, hard)
    limits = SpokeLimits.of(program)
    active = random_working_set(limits, seed, 0.3, 0.6)
    assert active.count > 50
    p = eliminated(program, limits, active)
    g = np.add(*program.gradient(p))
    n = len(p)
    held = np.flatnonzero((active.bounds != 0) | limits.given)
    linked = np.flatnonzero(active.links)
    C = np.zeros((len(held) + len(linked), n))
    C[np.arange(len(held)), held] = 1.0
    at = len(held) + np.arange(len(linked))
    C[at, linked], C[at, linked + limits.stride] = -1.0, 1.0  # p_w - p_v ≤ -s
    mu, _, rank, _ = np.linalg.lstsq(C.T, -g, rcond=None)
    assert rank == len(C)
    size = np.abs(g).max()
    assert np.abs(C.T @ mu + g).max() <= 1e-9 * size, "the minimiser balances"
    found = multipliers(limits, active, g)
    np.testing.assert_allclose(found.bounds[held], mu[: len(held)], atol=1e-9 * size)
    np.testing.assert_allclose(found.links[linked], mu[len(held) :], atol=1e-9 * size)
    assert not np.delete(found.bounds, held).any()
    assert not np.delete(found.links, linked).any()
