"""Coulomb's limits of two fields to the end, against Clarabel and all active sets."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import dragged_scene, with_wrenches
from tests.oracles.dense import enumerated, stacked
from tests.solvers.dual.user_limits import INF, Rows, Within
from ttus_opt.problem import formulation
from ttus_opt.problem.constraints.base import Bounds, Constraint, LinearRows
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.certificate import contradicts
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.dual.field_pair import FieldPair
from ttus_opt.solvers.dual.limits import Multipliers
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.dual.working_set import WorkingSet
from ttus_opt.solvers.registry import solvers
from ttus_opt.solvers.structured import Structured

STRUCTURED, CLARABEL = solvers()["structured"], solvers()["clarabel"]
TOLERANCE = 1e-6


def contested(seed, *, scale=1.0, noise=2.0, mu=0.3, shape=(7, 14, 8)):
    """A sliding probe, its forces scaled (or reversed), with noise on them [N]."""
    scene = dragged_scene("contact", mu=mu, shape=shape)
    noisy = np.random.default_rng(seed).normal(0.0, noise, scene.f.shape)
    return with_wrenches(scene, scale * scene.f + noisy)


def coulomb(scene, weight, *constraints, **options):
    declared = formulation.load(
        "coulomb_drag", scene, force_weight=weight, torque_weight=weight, **options
    )
    return declared.with_constraints(*constraints)


def solved(program):
    return Structured().prepare(program, Request(TOLERANCE, 120.0)).solve()


def check(declared, least_active, close=1e-5):
    """Verified to the tolerance, and Clarabel's fields and objective."""
    program = declared.compile()
    assert not STRUCTURED.refusal(program)
    candidate = solved(program)
    assert candidate.claim is Claim.DONE, candidate.detail
    residuals = kkt_residuals(program, candidate.x, candidate.duals)
    assert residuals.worst_relative <= TOLERANCE, residuals
    reference = CLARABEL.prepare(program, Request(1e-10, 120.0)).solve()
    assert active_limits(program, candidate) >= least_active, "nothing is contested"
    theirs = kkt_residuals(program, reference.x, reference.duals)
    # no further apart than what both leave open: Σ w ‖M (x − x′)‖² without targets
    still = replace(program, terms=tuple(_untargeted(t) for t in program.terms))
    apart = np.sqrt(still.objective(candidate.x - reference.x))
    assert apart <= 1.01 * (residuals.distance + theirs.distance)
    assert theirs.distance <= close * np.sqrt(program.objective(reference.x))
    p = program.variables["p"]
    apart = np.linalg.norm((candidate.x - reference.x)[p])
    assert apart <= close * np.linalg.norm(reference.x[p])


def _untargeted(term):
    return replace(term, target=np.zeros_like(term.target))


def active_limits(program, candidate):
    """Limits with a multiplier, those of given values apart."""
    lower, upper = program.box
    bounds = candidate.duals.bounds[lower < upper]
    found = [bounds, *(candidate.duals.rows[k] for k in ("drag_limit",))]
    sizes = np.abs(np.concatenate(found))
    return int(np.count_nonzero(sizes > 1e-6 * sizes.max()))


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, 0.1, 0.02])
@pytest.mark.parametrize("weight", [1.0, 100.0])
@pytest.mark.parametrize("forces", [(1.0, 2.0), (-3.0, 0.3), (-3.0, 2.0)])
def test_contested(forces, weight, share):
    scene = contested(1, scale=forces[0], noise=forces[1])
    check(coulomb(scene, weight, largest_friction=share), least_active=3)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [1.0, 100.0])
@pytest.mark.parametrize("share", [1.0, 0.1])
def test_the_safeguard_from_the_first_working_set_on(share, weight, monkeypatch):
    """What is kept for where the iteration cycles finds the same."""
    scene = contested(4, scale=-3.0)
    declared = coulomb(scene, weight, largest_friction=share)
    monkeypatch.setattr(options, "PATIENCE", 0)
    check(declared, least_active=3)


@pytest.mark.slow
@pytest.mark.parametrize("smoothness", [1e-2, 1e2])
@pytest.mark.parametrize("share", [1.0, 0.1])
def test_stiff_and_soft_drag(smoothness, share):
    scene = contested(2, noise=4.0)
    declared = coulomb(scene, 1.0, largest_friction=share, smoothness=smoothness)
    check(declared, least_active=1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_share_below_what_was_put_in(seed):
    """Measurements without noise that want three times what is allowed."""
    scene = contested(seed, noise=[0.0, 0.1, 0.0][seed], mu=[0.3, 0.3, 0.9][seed])
    check(coulomb(scene, 10.0, largest_friction=0.1), least_active=5)
    solution = tt.fit(scene, "coulomb_drag", largest_friction=0.1, force_weight=10.0)
    assert solution.solver == "structured"
    assert solution.parameters["mean_friction_coefficient"] <= 0.1
    region = scene.voxmap.region.reshape(-1)
    p, q = solution.variables["p"], solution.variables["q"]
    beside = region != 0
    assert ((0.1 * p - q) * region)[beside].min() >= -1e-6
    assert (q * region).min() >= -1e-6


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, 0.1])
def test_with_given_values_sign_and_bounds(share):
    scene = contested(3, scale=-3.0)
    V = scene.n_voxels
    rng = np.random.default_rng(3)
    where = (scene.voxmap.inside.reshape(-1)) & scene.laplace.free
    upper = np.where(where & (rng.random(V) < 0.3), rng.uniform(0.3, 2.0, V), INF)
    within = Within(scene, np.full(V, -INF), upper)
    for more in (
        [tt.constraints.HardBoundary(scene)],
        [tt.constraints.Sign(scene)],
        [within],
        [within, tt.constraints.Sign(scene), tt.constraints.HardBoundary(scene)],
    ):
        check(coulomb(scene, 1.0, *more, largest_friction=share), least_active=3)


@pytest.mark.slow
def test_a_new_solve_starts_from_the_last_working_set():
    scene = contested(1)
    loaded = coulomb(scene, 1.0, largest_friction=0.1)
    prepared = STRUCTURED.prepare(loaded.compile(), Request(TOLERANCE, 60.0))
    first = prepared.solve()
    other = coulomb(scene, 1.1, largest_friction=0.1).compile()
    prepared.update(other)
    again = prepared.solve()
    fresh = solved(other)
    assert again.iterations < first.iterations
    apart = np.linalg.norm(again.x - fresh.x)
    assert apart <= 1e-5 * np.linalg.norm(fresh.x)


@pytest.mark.parametrize("slope", [0.3, -0.3])
def test_the_unknown_beside_has_a_multiplier_at_its_limits_alone(slope, monkeypatch):
    """Of the sign that the limit can hold, where the objective has a given slope."""
    program = coulomb(contested(2), 1.0).compile()
    pair = FieldPair.of(program)
    x = 1e-3 * np.random.default_rng(3).normal(size=program.n_variables)
    none = Multipliers(*np.zeros((2, len(pair.limits.given))))
    (at,) = pair.others

    def of(c):
        x[at] = c
        return float(np.add(*program.gradient(x))[at])

    x[at] = c = (slope - of(0.0)) / (of(1.0) - of(0.0))
    found = []
    for limits in ((c, INF), (-INF, c), (-INF, INF)):
        box = [bound.copy() for bound in program.box]
        for bound, limit in zip(box, limits, strict=True):
            bound[at] = limit
        monkeypatch.setattr(Program, "box", box)
        z = pair.duals(x, none).bounds
        found.append(z[at])
    # at a lower limit negative, at an upper one positive
    expected = [min(-slope, 0.0), max(-slope, 0.0), 0.0]
    assert found == pytest.approx(expected, abs=1e-9)


def test_it_takes_a_share_of_nothing():
    scene = contested(1, noise=0.0, shape=(6, 12, 6)).with_boundary(0.0, 0.0)
    silent = with_wrenches(scene, 0.0 * scene.f, 0.0 * scene.tau)
    program = coulomb(silent, 1.0).compile()
    assert not STRUCTURED.refusal(program)
    candidate = solved(program)
    assert candidate.claim is Claim.DONE
    assert not candidate.x[: 2 * scene.n_voxels].any()


class OwnBounds(Within):
    """Bounds of the drag field made by a user."""

    name = "own"

    def rows(self):
        return Bounds("q", self.lower, self.upper)


def test_contradictions_are_named():
    """A field that must be negative inside has no share that is not."""
    scene = contested(1, shape=(6, 12, 6))
    V = scene.n_voxels
    deep = scene.voxmap.inside.reshape(-1) & scene.laplace.free
    below = Within(scene, np.full(V, -INF), np.where(deep, -0.5, INF))
    solution = tt.fit(scene, coulomb(scene, 1.0, below), solver="structured")
    assert solution.status is tt.Status.INFEASIBLE
    assert set(solution.conflict) == {"drag_sign", "drag_limit", "within"}
    more = OwnBounds(scene, np.where(deep, 1.0, -INF), np.full(V, INF))
    small = Within(scene, np.full(V, -INF), np.where(deep, 0.9, INF))
    solution = tt.fit(scene, coulomb(scene, 1.0, more, small), solver="structured")
    assert solution.status is tt.Status.INFEASIBLE
    assert set(solution.conflict) == {"drag_limit", "own", "within"}
    program = coulomb(scene, 1.0, more, small).compile()
    candidate = solved(program)
    assert candidate.claim is Claim.INFEASIBLE
    assert contradicts(program, candidate.duals)
    assert "contradict each other" in candidate.detail


class OtherShare(tt.constraints.DragLimit):
    """A second share."""

    name = "other_share"


class AtLeast(tt.constraints.DragLimit):
    """The drag field is at least a share of the field."""

    name = "at_least"

    def rows(self):
        rows = super().rows()
        return LinearRows(rows.blocks, -rows.upper, -rows.lower)


def test_says_what_it_does_not_take():
    scene = contested(1, shape=(6, 12, 6))
    mean = sp.csr_array(np.full((1, scene.n_voxels), 1.0))
    for constraint, why in (
        (OtherShare(scene, 0.5), "the share of the field differs between voxels"),
        (AtLeast(scene, 1.0), "at_least limits q on the other side too"),
        (Monotone(scene), "monotone is neither a bound nor a share of the field"),
        (Rows(scene, mean, np.zeros(1), np.ones(1)), "mine is neither a bound nor a"),
    ):
        refusal = STRUCTURED.refusal(coulomb(scene, 1.0, constraint).compile())
        assert why in refusal
    refusal = STRUCTURED.refusal(coulomb(scene, 1.0, smoothness=0.0).compile())
    assert "each field needs a Laplace term of positive weight" in refusal


@pytest.mark.parametrize("seed", range(3))
def test_all_active_sets_of_a_tiny_problem(seed):
    """Four voxels with limits: 0 ≤ q ≤ μ p at each, and 0 ≤ m ≤ μ."""
    share = [1.0, 0.1][seed % 2]
    scene = contested(seed, scale=[1.0, -3.0, 3.0][seed % 3], shape=(5, 8, 4))
    whole = coulomb(scene, 10.0, largest_friction=share)
    rng = np.random.default_rng(seed)
    touched = np.unique(scene.N.indices)
    inner = scene.voxmap.inside.reshape(-1) & scene.laplace.free
    at = rng.permutation(touched[inner[touched]])[:4]
    V = scene.n_voxels
    lower = np.full(V, -INF)
    upper = np.full(V, INF)
    skin = scene.voxmap.region.reshape(-1) == 0
    lower[skin], upper[skin], lower[at] = 0.0, 0.0, 0.0
    limit = tt.constraints.DragLimit(scene, share)
    every = limit.rows()
    where = np.flatnonzero(np.isin(every.blocks["q"].indices, at))
    some = LinearRows(
        {k: M[where] for k, M in every.blocks.items()},
        every.lower[where],
        every.upper[where],
    )
    few = [
        OwnBounds(scene, lower, upper),
        FewRows(scene, some),
        next(c for c in whole.constraints if c.name == "mean_friction"),
    ]
    program = tt.Formulation(whole.terms, few).compile()
    assert not STRUCTURED.refusal(program)
    unit, last = np.eye(program.n_variables), 2 * V
    rows = [*-unit[V + at], *(unit[V + at] - share * unit[at]), -unit[last], unit[last]]
    sides = np.append(np.zeros(len(rows) - 1), share)
    (low, high), (M, t) = program.box, stacked(program)
    free = low < high
    expected = np.where(free, 0.0, low)
    left, open_ = t - M @ expected, M.toarray()[:, free]
    sides -= np.array(rows) @ expected
    expected[free] = enumerated(open_, left, np.array(rows)[:, free], sides)
    found = solved(program)
    assert found.claim is Claim.DONE, found.detail
    apart = np.linalg.norm(found.x - expected)
    assert apart <= 1e-6 * np.linalg.norm(expected)


class FewRows(Constraint):
    """Some rows of another constraint."""

    name = "few"
    formula = "q ≤ μ_max p at some voxels"

    def __init__(self, scene, some):
        object.__setattr__(self, "scene", scene)
        object.__setattr__(self, "some", some)

    def rows(self):
        return self.some


@pytest.mark.slow
def test_case_s_with_a_share_below_what_was_put_in():
    """24×72×30 with hundreds of limits active; no other solver returns in minutes."""
    scene = contested(0, noise=0.3, shape=(24, 72, 30))
    declared = coulomb(scene, 100.0, largest_friction=0.1)
    # `fit` would take a coefficient at its upper limit for none and fit again
    solution = tt.Fitter(declared, solver="structured").solve()
    assert solution.status is tt.Status.SOLVED
    assert solution.kkt.worst_relative <= TOLERANCE
    found = np.abs(solution.duals_by_name["drag_limit"])
    assert np.count_nonzero(found > 1e-6 * found.max()) > 300


def test_without_a_model_no_working_set_is_predicted(monkeypatch):
    """Where too many voxels are touched, violations alone lead to the answer."""
    monkeypatch.setattr("ttus_opt.solvers.dual.touched_limits.MOST_VOXELS", 0)
    declared = coulomb(contested(1), 1e2)
    pair = FieldPair.of(declared.compile())
    nothing = np.zeros(len(pair.limits.lower))
    signs = Multipliers(nothing, nothing)
    assert pair.predicted(WorkingSet.empty(len(nothing)), nothing, signs) is None
    check(declared, 1)


def scaled(program, factor):
    """All terms as many times as heavy."""
    terms = (replace(t, weight=factor * t.weight) for t in program.terms)
    return replace(program, terms=tuple(terms))


@pytest.mark.parametrize("seed", [1, 2])
def test_from_any_working_set_the_same_one_is_predicted(seed):
    """Where y touches its bound as it must; in any unit of the objective."""
    program = coulomb(contested(seed), 1e2).compile()
    found = []
    for factor, step in itertools.product((1.0, 9.0), (None, 2, 3)):
        pair = FieldPair.of(scaled(program, factor))
        n, model = len(pair.limits.lower), pair._touched
        at = n // 2 + model.voxels
        bounds = np.zeros(n, np.int8)
        bounds[at[::step] if step else []] = -1
        held = WorkingSet(bounds, np.zeros(n, bool))
        p = pair.subproblem(held).solve(Accuracy(1e-10), None).p
        multipliers = np.where(bounds < 0, -pair.gradient(p), 0.0)
        following = pair.predicted(held, p, Multipliers(multipliers, np.zeros(n)))
        found.append(following.bounds)
    assert (np.array(found) == found[0]).all()
    p = pair.subproblem(following).solve(Accuracy(1e-10), None).p
    touching = following.bounds[at] < 0
    assert 0 < touching.sum() < len(at)
    assert (pair.gradient(p)[at[touching]] > 0.0).all()
    assert (p > pair.limits.lower)[at[~touching]].all()
