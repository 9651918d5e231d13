"""Limits read off programs, and their contradictions against a linear program."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

from tests.kit import small_scene, some
from tests.solvers.dual.user_limits import Rows, Steeper, Within
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.dual.limits import Multipliers, SpokeLimits, two_entries

INF = np.inf


@pytest.fixture(scope="module")
def small():
    return small_scene("trilinear", shape=(6, 10, 5), n_poses=4)


def read(scene, *constraints):
    return SpokeLimits.of(load("eq10", scene).with_constraints(*constraints).compile())


def rows_of(scene, entries):
    M = sp.lil_array((len(entries), scene.n_voxels))
    for i, row in enumerate(entries):
        for column, value in row.items():
            M[i, column] = value
    return sp.csr_array(M)


def test_nothing_given_is_nothing_limited(small):
    limits = read(small)
    assert not limits.binding
    assert not limits.given.any()
    assert limits.contradiction() == 0.0
    assert not limits.links
    duals = limits.duals(Multipliers(*np.zeros((2, small.n_voxels))))
    assert not duals.rows


def test_hard_boundary_gives_values(small):
    limits = read(small, HardBoundary(small))
    fixed = ~small.laplace.free
    np.testing.assert_array_equal(limits.given, fixed)
    np.testing.assert_array_equal(limits.lower[fixed], small.b[fixed])
    np.testing.assert_array_equal(limits.upper[fixed], small.b[fixed])
    assert not limits.binding
    assert read(small, HardBoundary(small), Sign(small)).binding


def test_several_bounds_and_links_leave_the_tightest(small):
    rng = np.random.default_rng(0)
    V, stride = small.n_voxels, small.voxmap.grid.strides[0]
    lower, upper = -rng.random(V), rng.random(V)
    entries = [{v: 1.0, v + stride: -1.0} for v in range(stride)]
    mine = Rows(
        small, rows_of(small, entries), np.full(stride, 3.0), np.full(stride, INF)
    )
    limits = read(small, Sign(small), Within(small, lower, upper), Monotone(small))
    both = read(small, Sign(small), Within(small, lower, upper), Monotone(small), mine)
    region = small.voxmap.region.reshape(-1)
    np.testing.assert_array_equal(
        limits.lower, np.where(region == 1, np.maximum(lower, 0.0), lower)
    )
    np.testing.assert_array_equal(
        limits.upper, np.where(region == -1, np.minimum(upper, 0.0), upper)
    )
    np.testing.assert_array_equal(both.least[:stride], 3.0)
    np.testing.assert_array_equal(both.least[stride:], limits.least[stride:])


def test_a_row_may_be_written_the_other_way_round(small):
    """p_w - p_v ≤ -s is p_v - p_w ≥ s."""
    stride = small.voxmap.grid.strides[0]
    entries = [{3: 1.0, 3 + stride: -1.0}, {9: -1.0, 9 + stride: 1.0}]
    limits = read(
        small,
        Rows(
            small,
            rows_of(small, entries),
            np.array([0.5, -INF]),
            np.array([INF, -0.25]),
        ),
    )
    assert limits.least[3] == 0.5
    assert limits.least[9] == 0.25
    assert np.isfinite(limits.least).sum() == 2
    of_links = np.zeros(small.n_voxels)
    of_links[[3, 9]] = 2.0, 5.0
    duals = limits.duals(Multipliers(np.zeros(small.n_voxels), of_links))
    # at a lower limit negative, at an upper one positive
    np.testing.assert_array_equal(duals.rows["mine"], [-2.0, 5.0])


_REFUSED = {
    "three voxels": ([{0: 1.0, 50: -1.0, 100: 1.0}], 0.0, INF),
    "one voxel": ([{0: 1.0}], 0.0, INF),
    "over two layers": ([{0: 1.0, 100: -1.0}], 0.0, INF),
    "along the axis": ([{0: 1.0, 1: -1.0}], 0.0, INF),
    "around": ([{0: 1.0, 5: -1.0}], 0.0, INF),
    "a sum": ([{0: 1.0, 50: 1.0}], 0.0, INF),
    "not of equal size": ([{0: 1.0, 50: -0.5}], 0.0, INF),
    "scaled": ([{0: 2.0, 50: -2.0}], 0.0, INF),
    "scaled down": ([{0: 0.5, 50: -0.5}], 0.0, INF),
    "least growth outwards": ([{0: -1.0, 50: 1.0}], 0.0, INF),
    "most growth inwards": ([{0: 1.0, 50: -1.0}], -INF, 0.0),
    "both sides": ([{0: 1.0, 50: -1.0}], 0.0, 1.0),
    "an equality": ([{0: 1.0, 50: -1.0}], 0.0, 0.0),
    "twice": ([{0: 1.0, 50: -1.0}, {0: 1.0, 50: -1.0}], 0.0, INF),
    "one good, one bad": ([{0: 1.0, 50: -1.0}, {7: 1.0, 8: -1.0}], 0.0, INF),
}


@pytest.mark.parametrize("what", _REFUSED)
def test_other_rows_are_refused_by_name(small, what):
    entries, lower, upper = _REFUSED[what]
    assert small.voxmap.grid.strides[0] == 50
    m = len(entries)
    bad = Rows(small, rows_of(small, entries), np.full(m, lower), np.full(m, upper))
    with pytest.raises(ValueError, match="mine is neither a bound nor growth"):
        read(small, Sign(small), bad)


def random_limits(seed, spoke=6, spokes=4):
    """Bounds, given values and links at random, contradicting each other or not."""
    rng = np.random.default_rng(seed)
    n = spoke * spokes
    reach = rng.choice([0.5, 2.0, 5.0])
    lower = np.where(rng.random(n) < 0.5, rng.uniform(-reach, 0.3, n), -INF)
    upper = np.where(rng.random(n) < 0.5, rng.uniform(-0.3, reach, n), INF)
    given = rng.random(n) < 0.15
    lower[given] = upper[given] = rng.uniform(-0.5, 0.5, given.sum())
    least = np.where(rng.random(n) < 0.6, rng.uniform(-0.3, 0.6, n), -INF)
    least[-spokes:] = -INF
    return SpokeLimits((spoke, 2, spokes // 2), lower, upper, given, least, {})


def least_give(limits):
    """The least t for which limits hold when each bound gives way by t / 2."""
    n, stride = len(limits.lower), limits.stride
    rows, sides = [], []
    for v in range(n):
        for sign, value in ((-1.0, limits.lower[v]), (1.0, limits.upper[v])):
            if np.isfinite(value):
                row = np.zeros(n + 1)
                row[v], row[n] = sign, -0.5
                rows.append(row)
                sides.append(sign * value)
        if np.isfinite(limits.least[v]):
            row = np.zeros(n + 1)
            row[v], row[v + stride] = -1.0, 1.0
            rows.append(row)
            sides.append(-limits.least[v])
    cost = np.zeros(n + 1)
    cost[n] = 1.0
    result = linprog(
        cost,
        A_ub=np.array(rows),
        b_ub=np.array(sides),
        bounds=[(None, None)] * n + [(0.0, None)],
        method="highs",
    )
    assert result.status == 0
    return float(result.fun)


@pytest.mark.slow
def test_contradiction_is_the_least_give_of_a_linear_program():
    """Two bounds in conflict by x can both hold when each gives way by x / 2."""
    found = []
    for seed in range(150):
        limits = random_limits(seed)
        give = least_give(limits)
        assert limits.contradiction() == pytest.approx(give, abs=1e-7), seed
        found.append(give > 1e-9)
    assert 20 < sum(found) < 130, "random limits should be of both kinds"


@pytest.mark.parametrize("seeds", some([range(60), range(60, 300)], 1))
def test_a_proof_is_of_the_worst_contradiction(seeds):
    """Multipliers under which the limits' sum reads 0 ≤ −(what is missing)."""
    proved = 0
    for seed in seeds:
        limits = random_limits(seed)
        linked = np.flatnonzero(np.isfinite(limits.least))
        given = limits.given
        rows = (linked, np.ones(len(linked)), limits.least[linked])
        limits = replace(limits, links={"mine": rows}, given_by="given")
        missing, proof = limits.contradiction(), limits.proof_of_contradiction()
        if proof is None:  # none at all, or at one voxel, which no link has a part in
            own = float((limits.lower - limits.upper).max())
            assert missing == pytest.approx(max(own, 0.0))
            continue
        proof = limits.duals(proof)
        assert proof.bounds is not None and (proof.rows["mine"] <= 0.0).all()
        z, y = proof.bounds.copy(), proof.rows["mine"]
        assert not z[given].any()
        z[given] = proof.rows["given"]
        total = z.copy()
        np.add.at(total, linked, y)
        np.add.at(total, linked + limits.stride, -y)
        np.testing.assert_array_equal(total, 0.0)
        high, low = z > 0.0, z < 0.0
        least = z[high] @ limits.upper[high] + z[low] @ limits.lower[low]
        assert least + y @ limits.least[linked] == pytest.approx(-missing)
        assert missing > 0.0
        proved += 1
    assert proved > len(seeds) / 10


def test_each_kind_of_limit_binds():
    """A lower or an upper bound of a voxel without a given value, or a link."""
    free, none = np.full(8, -INF), np.zeros(8, bool)
    limits = SpokeLimits((2, 2, 2), free, -free, none, free, {})
    one = np.where(np.arange(8) == 3, 1.0, -INF)
    assert not limits.binding
    assert replace(limits, lower=one).binding
    assert replace(limits, upper=-one).binding
    assert replace(limits, least=one).binding
    given = np.isfinite(one)
    assert not replace(limits, lower=one, upper=np.abs(one), given=given).binding


def test_duals_have_names_signs_and_balance_the_gradient(small):
    """Any multipliers, put back through the rows, is what was handed in."""
    declared = load("eq10", small).with_constraints(
        Sign(small), Monotone(small), HardBoundary(small)
    )
    loaded = declared.compile()
    limits = SpokeLimits.of(loaded)
    rng = np.random.default_rng(3)
    of_bounds = rng.normal(size=small.n_voxels)
    linked = np.isfinite(limits.least)
    of_links = np.where(linked, rng.random(small.n_voxels), 0.0)
    duals = limits.duals(Multipliers(of_bounds, of_links))
    assert set(duals.rows) == {"monotone", "boundary"}
    assert (duals.rows["monotone"] <= 0.0).all()  # at lower limits all
    assert not duals.bounds[limits.given].any()
    total = duals.bounds.copy()
    for constraint in loaded.constraints:
        total += constraint.matrix.T @ duals.rows[constraint.name]
    expected = of_bounds - of_links
    expected[limits.stride :] += of_links[: -limits.stride]
    np.testing.assert_allclose(total, expected, atol=1e-14)


def test_of_two_constraints_on_a_link_the_tighter_one_carries_it(small):
    loaded = (
        load("eq10", small)
        .with_constraints(Monotone(small, 0.0), Steeper(small, 3.0))
        .compile()
    )
    limits = SpokeLimits.of(loaded)
    of_links = np.where(np.isfinite(limits.least), 1.0, 0.0)
    duals = limits.duals(Multipliers(np.zeros(small.n_voxels), of_links))
    assert not duals.rows["monotone"].any()
    np.testing.assert_array_equal(duals.rows["steeper"], -1.0)


def least_value(limits, v, sign):
    """The least value sign · p_v can have within limits, by a linear program."""
    n, stride = len(limits.lower), limits.stride
    linked = np.flatnonzero(np.isfinite(limits.least))
    rows = np.zeros((len(linked), n))
    rows[np.arange(len(linked)), linked] = -1.0
    rows[np.arange(len(linked)), linked + stride] = 1.0
    cost = np.zeros(n)
    cost[v] = sign
    result = linprog(
        cost,
        A_ub=rows,
        b_ub=-limits.least[linked],
        bounds=np.stack([limits.lower, limits.upper], axis=1),
        method="highs",
    )
    return float(result.fun) if result.status == 0 else -INF


@pytest.mark.parametrize("seeds", some([range(12), range(12, 60)], 1))
def test_bounds_are_dropped_only_where_others_imply_them(seeds):
    dropped = 0
    for seed in seeds:
        limits = random_limits(seed)
        if limits.contradiction() > 0.0:
            continue
        fewer = limits.without_implied()
        np.testing.assert_array_equal(
            fewer.lower[limits.given], limits.lower[limits.given]
        )
        for sign, before, after in (
            (1.0, limits.lower, fewer.lower),
            (-1.0, limits.upper, fewer.upper),
        ):
            gone = np.flatnonzero(np.isfinite(before) & ~np.isfinite(after))
            dropped += len(gone)
            for v in gone:
                assert least_value(fewer, int(v), sign) >= sign * before[v] - 1e-9
    assert dropped > len(seeds) / 3


def test_of_bounds_along_a_spoke_those_next_to_the_skin_are_left(small):
    """The skin itself has no bound; what grows inwards from 0 stays above 0."""
    limits = read(small, Sign(small), Monotone(small)).without_implied()
    left = np.flatnonzero(np.isfinite(limits.lower) & np.isfinite(limits.least))
    assert len(left)
    region = small.voxmap.region.reshape(-1)
    assert (region[left + limits.stride] == 0).all()


def test_two_entries_come_by_columns_whatever_their_order():
    rows = sp.csr_array(([1.0, -2.0, 3.0, -4.0], [5, 0, 1, 6], [0, 2, 4]), shape=(2, 9))
    columns, values = two_entries(rows)
    np.testing.assert_array_equal(columns, [[0, 5], [1, 6]])
    np.testing.assert_array_equal(values, [[-2.0, 1.0], [3.0, -4.0]])
