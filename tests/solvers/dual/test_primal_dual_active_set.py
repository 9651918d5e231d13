"""Contested limits: the iteration to its end, against Clarabel and all active sets."""

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.ndimage import generate_binary_structure, maximum_filter

import ttus_opt as tt
from tests.kit import refuses, some, torso, with_wrenches
from tests.oracles.dense import enumerated, stacked
from tests.solvers.dual.test_subproblem import shaped
from tests.solvers.dual.user_limits import INF, Steeper, Within, contested, eq10, louder
from tests.solvers.test_structured import rough_surface
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.solution import NoSolutionError, Status
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.dual import active_set, options
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.optimality import Violations
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.dual.subproblem import LimitedField
from ttus_opt.solvers.dual.working_set import WorkingSet
from ttus_opt.solvers.registry import solvers
from ttus_opt.solvers.structured import Structured

STRUCTURED, CLARABEL = solvers()["structured"], solvers()["clarabel"]
TOLERANCE = 1e-6


def solved(program, tolerance=TOLERANCE):
    return Structured().prepare(program, Request(tolerance, 60.0)).solve()


def active_limits(program, p):
    """How many limits hold with equality, given values apart."""
    scale = 1e-7 * np.abs(p).max()
    lower, upper = program.box
    count = int(np.sum((p - lower <= scale) | (upper - p <= scale)))
    for constraint in program.constraints:
        if constraint.name != HardBoundary.name:
            value = constraint.matrix @ p
            near = (value - constraint.lower <= scale) | (
                constraint.upper - value <= scale
            )
            count += int(np.sum(near))
    return count


def check(declared, least_active=1, close=1e-5):
    """Verified to the tolerance, and Clarabel's field."""
    program = declared.compile()
    assert not STRUCTURED.refusal(program)
    candidate = solved(program)
    assert candidate.claim is Claim.DONE, candidate.detail
    residuals = kkt_residuals(program, candidate.x, candidate.duals)
    assert residuals.worst_relative <= TOLERANCE, residuals
    # at 1e-8 its field is further off than ours where weights are large
    reference = CLARABEL.prepare(program, Request(1e-10, 60.0)).solve()
    assert active_limits(program, candidate.x) >= least_active, "nothing is contested"
    apart = np.linalg.norm(candidate.x - reference.x)
    assert apart <= close * np.linalg.norm(reference.x)


FORCES = {"noise": (1.0, 2.0), "reversed": (-3.0, 0.3), "both": (-3.0, 2.0)}


#: By what limits, of a scene
KINDS = {
    "sign": lambda scene: [Sign(scene)],
    "monotone": lambda scene: [Monotone(scene)],
    "sign, monotone": lambda scene: [Sign(scene), Monotone(scene)],
    "sign, some slope": lambda scene: [Sign(scene), Monotone(scene, 10.0)],
    "slope above the field's": lambda scene: [Monotone(scene, 60.0)],
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("weight", some([100.0, 1.0], 1))
@pytest.mark.parametrize("forces", some(FORCES, 2))
def test_contested(forces, weight, kind):
    scale, noise = FORCES[forces]
    scene = contested(1, scale=scale, noise=noise)
    check(eq10(scene, weight, *KINDS[kind](scene)))


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
@pytest.mark.parametrize("kind", list(KINDS)[:4])
def test_contested_with_hard_boundary(kind, sampling):
    scene = contested(2, sampling=sampling, scale=-3.0)
    check(eq10(scene, 1.0, HardBoundary(scene), *KINDS[kind](scene)))


def working_sets(candidate):
    return int(candidate.detail.split(" working sets")[0])


@pytest.mark.slow
def test_a_volume_of_growth_limits_does_not_grow_by_layers(monkeypatch):
    """With the peaks alone, as for bounds, the same takes far more working sets."""
    scene = contested(0, (14, 28, 16), n_poses=60, scale=-3.0)
    program = eq10(scene, 100.0, Sign(scene), Monotone(scene)).compile()
    found = solved(program)
    with monkeypatch.context() as peaks:
        peaks.setattr(LimitedField, "links_along_spokes", False)
        slowly = solved(program)
    assert found.claim is slowly.claim is Claim.DONE
    assert np.linalg.norm(found.x - slowly.x) <= 1e-6 * np.linalg.norm(slowly.x)
    assert active_limits(program, found.x) > 100
    assert working_sets(found) < 0.75 * working_sets(slowly)


@pytest.mark.slow
def test_limits_that_hardly_matter_end_the_iteration(monkeypatch):
    """What may remain is within the tolerance, also if it may remain at once."""
    sets = []
    for seed in (2, 4, 5):
        scene = contested(seed, (12, 24, 14), noise=4.0)
        program = eq10(scene, 100.0, Sign(scene), Monotone(scene)).compile()
        whole = solved(program, 1e-2)
        with monkeypatch.context() as soon:
            soon.setattr(active_set, "ACCEPTABLE", 1.0)
            soon.setattr(active_set, "ACCEPTABLE_SETS", 0)
            cut = solved(program, 1e-2)
        assert cut.claim is Claim.DONE
        assert kkt_residuals(program, cut.x, cut.duals).worst_relative <= 1e-2
        sets.append((working_sets(cut), working_sets(whole)))
    assert all(few <= many for few, many in sets)
    assert any(few < many for few, many in sets)


@pytest.mark.slow
def test_too_few_working_sets_are_no_answer(monkeypatch):
    """What it ended on is told as that, and not started from."""
    scene = contested(1, scale=-3.0, noise=2.0)
    program = eq10(scene, 100.0, Sign(scene), Monotone(scene)).compile()
    prepared = STRUCTURED.prepare(program, Request(TOLERANCE))
    with monkeypatch.context() as patch:
        patch.setattr(options, "MAX_WORKING_SETS", 2)
        cut = prepared.solve()
    assert cut.claim is not Claim.DONE
    assert cut.detail.startswith("2 working sets")
    whole, fresh = prepared.solve(), solved(program)
    assert whole.detail == fresh.detail
    assert whole.claim is Claim.DONE
    assert kkt_residuals(program, whole.x, whole.duals).worst_relative <= TOLERANCE
    assert np.linalg.norm(cut.x - whole.x) > 1e-6 * np.linalg.norm(whole.x)


def inside(scene):
    return scene.voxmap.inside.reshape(-1)


def layer(scene):
    shape = scene.voxmap.grid.shape
    return np.repeat(np.arange(shape[0]), shape[1] * shape[2])


def random_box(scene, seed, hard):
    """Bounds at half of the inside's voxels, at random."""
    rng = np.random.default_rng(seed)
    V = scene.n_voxels
    where = inside(scene) & (scene.laplace.free if hard else True)
    lower = np.where(where & (rng.random(V) < 0.5), rng.uniform(-1.0, 0.2, V), -INF)
    upper = np.where(where & (rng.random(V) < 0.5), rng.uniform(0.2, 2.0, V), INF)
    return Within(scene, lower, upper)


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("seed", range(2))
def test_lower_and_upper_bounds(seed, hard):
    scene = contested(seed, scale=[1.0, -3.0, 3.0][seed])
    more = [HardBoundary(scene)] if hard else []
    check(eq10(scene, 1.0, random_box(scene, seed, hard), *more), least_active=5)


@pytest.mark.slow
def test_bounds_that_hold_everywhere():
    """Lower and upper bound are one value, at every voxel or in one layer."""
    scene = contested()
    same = np.full(scene.n_voxels, 0.3)
    check(eq10(scene, 1.0, Within(scene, same, same)), scene.n_voxels)
    second = layer(scene) == 2
    lower, upper = np.where(second, 0.3, -INF), np.where(second, 0.3, INF)
    check(eq10(scene, 1.0, Within(scene, lower, upper)), int(second.sum()))
    free = scene.laplace.free
    lower, upper = np.where(free, 0.3, -INF), np.where(free, 0.3, INF)
    hard = eq10(scene, 1.0, Within(scene, lower, upper), HardBoundary(scene))
    check(hard, int(free.sum()))


def test_no_field_and_no_force_is_no_field():
    scene = contested().with_boundary(0.0, 0.0)
    scene = with_wrenches(scene, 0.0 * scene.f, 0.0 * scene.tau)
    candidate = solved(eq10(scene, 1.0, Sign(scene), Monotone(scene)).compile())
    assert candidate.claim is Claim.DONE
    assert not candidate.x.any()


SURFACES = {
    "touches the edge": (torso(), (8, 16, 7), float(torso().radius.max())),
    "pockets": (rough_surface(0), (9, 16, 8), None),
    "pockets at the edge": (
        rough_surface(1),
        (8, 15, 9),
        float(rough_surface(1).radius.max()),
    ),
    "one slice": (torso(), (9, 21, 3), None),
    "tiny": (torso(), (5, 4, 3), None),
}


# given values of the inner layer leave no room for a slope
@pytest.mark.slow
@pytest.mark.parametrize(
    ("hard", "kind"),
    [
        (False, "sign, some slope"),
        (True, "sign, monotone"),
        pytest.param(False, "sign, monotone", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("name", SURFACES)
def test_geometry_that_breaks_careless_solvers(hard, name, kind):
    surface, shape, r_outer = SURFACES[name]
    scene = shaped(surface, shape, r_outer)
    more = [HardBoundary(scene)] if hard else []
    check(eq10(scene, 1.0, *more, *KINDS[kind](scene)), least_active=0)


def of_all_active_sets(program):
    """The minimiser by dense algebra; None if no active set will do."""
    M, t = stacked(program)
    M, n = M.toarray(), program.n_variables
    lower, upper = program.box
    low, high = np.isfinite(lower), np.isfinite(upper)
    G, h = [-np.eye(n)[low], np.eye(n)[high]], [-lower[low], upper[high]]
    p, open_ = np.zeros(n), np.ones(n, dtype=bool)
    for constraint in program.constraints:
        if constraint.name == HardBoundary.name:
            open_[constraint.matrix.indices] = False
            p[constraint.matrix.indices] = constraint.lower
        else:
            G.append(-constraint.matrix.toarray())
            h.append(-constraint.lower)
    rows, sides = np.vstack(G), np.concatenate(h) - np.vstack(G) @ p
    assert len(rows) <= 14, "too many active sets"
    found = enumerated(M[:, open_], t - M @ p, rows[:, open_], sides)
    if found is None:
        return None
    p[open_] = found
    return p


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("seed", some(range(8), 2))
def test_all_active_sets_of_a_tiny_problem(seed, hard):
    """Sixty voxels, four bounds and all links; where no set will do, none is found."""
    rng = np.random.default_rng(seed)
    scene = louder(shaped(torso(), (5, 4, 3), None), seed, [1.0, -3.0][seed % 2])
    V = scene.n_voxels
    loose = rng.permutation(np.flatnonzero(scene.laplace.free & inside(scene)))
    plain = solved(eq10(scene, 1.0).compile()).x
    size = np.abs(plain[loose]).max()
    lower, upper = np.full(V, -INF), np.full(V, INF)
    lower[loose[:2]] = plain[loose[:2]] + rng.uniform(-0.1, 0.5, 2) * size
    upper[loose[2:4]] = plain[loose[2:4]] - rng.uniform(-0.1, 0.5, 2) * size
    more = [HardBoundary(scene)] if hard else []
    within = Within(scene, lower, upper)
    program = eq10(scene, 1.0, within, Monotone(scene, 2.0), *more).compile()
    expected = of_all_active_sets(program)
    candidate = solved(program)
    if expected is None:
        assert candidate.claim is Claim.INFEASIBLE
        return
    assert candidate.claim is Claim.DONE, candidate.detail
    apart = np.linalg.norm(candidate.x - expected)
    assert apart <= 1e-7 * np.linalg.norm(expected)


def contradictions():
    """Scene, limits, and which of them cannot hold together."""
    scene = contested()
    where, at = inside(scene) & scene.laplace.free, layer(scene)
    hard, turned = HardBoundary(scene), scene.with_boundary(-1.0, 1.0)
    # given values of both ends of a spoke are too near for the slope asked
    yield scene, [Sign(scene), Monotone(scene, 400.0), hard], {"monotone", "boundary"}
    growing = np.where(where, 0.1 * at, -INF)  # lower bounds rise outwards
    yield scene, [Within(scene, growing, np.where(where, 0.15, INF))], {"within"}
    upper = np.where(where & (at == 1), 0.1, INF)
    lower = np.where(where & (at == 2), 0.05, -INF)
    within = Within(scene, lower, upper)
    yield scene, [within, Monotone(scene, 50.0)], {"monotone", "within"}
    yield turned, [Sign(turned), HardBoundary(turned)], {"boundary", "sign"}


def test_contradictions_are_named():
    for scene, limits, names in contradictions():
        declared = eq10(scene, 1.0, *limits)
        solution = tt.fit(scene, declared, solver="structured")
        assert solution.status is Status.INFEASIBLE
        assert set(solution.conflict) == names and "contradict" in solution.detail
        with pytest.raises(NoSolutionError, match=" against ".join(solution.conflict)):
            solution.field  # noqa: B018


def test_stops_when_the_time_is_up():
    """Cut short it has taken fewer steps, and says so."""
    scene = contested(0, (14, 36, 16), n_poses=60, scale=-3.0)
    program = eq10(scene, 100.0, Sign(scene), Monotone(scene, 5.0)).compile()
    whole = solved(program)
    assert whole.claim is Claim.DONE
    for limit in (1e-6, 0.02):
        cut = STRUCTURED.prepare(program, Request(TOLERANCE, limit)).solve()
        assert cut.claim is Claim.TIME_LIMIT
        assert cut.iterations < whole.iterations / 2
    solution = tt.fit(
        scene,
        eq10(scene, 100.0, Sign(scene), Monotone(scene, 5.0)),
        solver="structured",
        time_limit=1e-6,
    )
    assert solution.status is Status.TIME_LIMIT
    refuses(NoSolutionError, "", lambda: solution.field)


def updated(first, second):
    """A solve after an update is a fresh solve."""
    prepared = STRUCTURED.prepare(first.compile(), Request(1e-8, 60.0))
    prepared.solve()
    program = second.compile()
    prepared.update(program)
    again, fresh = prepared.solve(), solved(program, 1e-8)
    assert again.claim is Claim.DONE
    residuals = kkt_residuals(program, again.x, again.duals)
    assert residuals.worst_relative <= 1e-8
    apart = np.linalg.norm(again.x - fresh.x)
    assert apart <= 1e-6 * np.linalg.norm(fresh.x)


def limited(scene, weight=1.0, slope=5.0):
    return eq10(scene, weight, Sign(scene), Monotone(scene, slope))


@pytest.mark.slow
def test_other_values_weights_and_slopes_agree_with_a_fresh_solve():
    scene = contested(0)
    first = limited(scene)
    updated(first, limited(contested(0, scale=-2.0)))
    updated(first, limited(scene, weight=30.0))
    updated(first, limited(scene, slope=20.0))
    updated(first, limited(scene, slope=0.0))
    updated(first, limited(scene.with_boundary(1.0, 2.0)))
    updated(first, limited(contested(0, n_poses=14)))


def test_a_bound_parts_a_voxel_from_the_given_value_it_is_pooled_with():
    """Forces draw below the skin's 0 what has a bound above it: bound, not link."""
    scene = contested(scale=-3.0)
    where = inside(scene) & scene.laplace.free
    lower = np.where(where, 0.05, -INF)
    within = Within(scene, lower, np.full(scene.n_voxels, INF))
    check(eq10(scene, 1.0, within, Monotone(scene), HardBoundary(scene)))


@pytest.mark.parametrize(("seed", "hard"), [(1, True), (5, False)])
def test_of_two_bounds_in_a_block_the_tighter_one_holds(seed, hard):
    """Random bounds and links together."""
    scene = contested(seed, (6, 9, 5), n_poses=6, scale=[1.0, -3.0][seed % 2])
    more = [HardBoundary(scene)] if hard else []
    check(eq10(scene, 1.0, random_box(scene, seed, hard), Monotone(scene), *more))


def test_two_growths_on_one_link_in_any_order():
    scene = contested()
    for both in itertools.permutations([Monotone(scene), Steeper(scene, 30.0)]):
        check(eq10(scene, 1.0, *both))


@pytest.mark.slow
def test_an_update_whose_bound_has_become_implied():
    """The same constraints; the second layer's bound now implies the first one's."""
    scene = contested()
    V, i = scene.n_voxels, layer(scene)
    where = inside(scene) & scene.laplace.free

    def bounded(first):
        lower = np.where(where & (i == 1), first, np.where(where & (i == 2), 5.0, -INF))
        within = Within(scene, lower, np.full(V, INF))
        return eq10(scene, 1.0, within, Monotone(scene))

    updated(bounded(6.0), bounded(4.0))


@pytest.mark.parametrize("what", ["no growth", "no sign", "hard", "none", "grid"])
def test_an_update_with_other_limits_or_another_grid(what):
    scene = contested()
    sign, monotone, hard = Sign(scene), Monotone(scene, 5.0), HardBoundary(scene)
    others = {
        "no growth": eq10(scene, 1.0, sign),
        "no sign": eq10(scene, 1.0, monotone),
        "hard": eq10(scene, 1.0, sign, monotone, hard),
        "none": eq10(scene, 1.0),
        "grid": limited(contested(shape=(6, 10, 6))),
    }
    updated(limited(scene), others[what])


@pytest.mark.slow
@pytest.mark.parametrize("seeds", some([range(6), range(6, 60)], 1))
def test_random_limits_of_all_kinds_are_settled(seeds):
    """Bounds, links, given values, weights and slopes drawn at random; KKT hold."""
    unsettled = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        shape = [(6, 9, 5), (7, 8, 6), (5, 4, 3)][seed % 3]
        scale, hard = rng.choice([1.0, -3.0, 5.0]), bool(rng.random() < 0.5)
        scene = contested(seed, shape, n_poses=6, scale=scale)
        constraints = [
            random_box(scene, seed, hard),
            Monotone(scene, rng.choice([0.0, 3.0])),
        ]
        if hard:
            constraints.append(HardBoundary(scene))
        program = eq10(scene, rng.choice([1e-2, 1.0, 100.0]), *constraints).compile()
        candidate = solved(program)
        if candidate.x is None:  # contradictions have tests of their own
            continue
        kkt = kkt_residuals(program, candidate.x, candidate.duals)
        if candidate.claim is not Claim.DONE or kkt.worst_relative > TOLERANCE:
            unsettled.append((seed, candidate.detail, kkt.worst_relative))
    assert not unsettled


@pytest.mark.parametrize("height", [2.0, 1.0 - 1e-9], ids=["risen", "but for rounding"])
def test_where_the_minimum_does_not_rise_half_of_the_changes_are_taken_back(height):
    """From the last working set after which it rose; a single change cannot fail."""
    V = 6
    limits = SpokeLimits(
        (V, 1, 1), np.zeros(V), np.full(V, INF), np.zeros(V, bool), np.full(V, -INF), {}
    )
    sizes = np.array([0.5, 0.4, 0.3, 0.2, -INF, -INF])
    none = np.full(V, -INF)
    found = Violations(sizes, np.full(V, -1, dtype=np.int8), none)
    start, safeguard = WorkingSet.empty(V), active_set._Safeguard()
    following = safeguard.following(limits, start, found, 1.0)
    assert following.bounds.tolist() == [-1, -1, -1, -1, 0, 0]
    for active in ([-1, -1, 0, 0, 0, 0], [-1, 0, 0, 0, 0, 0]):  # it falls, and falls
        last = replace(found, bounds=np.where(np.arange(V) == V - 1, 0.9, none))
        following = safeguard.following(limits, following, last, 0.5)
        assert following.bounds.tolist() == active
    second = replace(found, bounds=np.where(np.arange(V) == 1, 0.1, none))
    risen = safeguard.following(limits, following, second, height)
    assert risen.bounds.tolist() == [-1, -1, 0, 0, 0, 0]


def test_patience_ends_where_nothing_gets_better(monkeypatch):
    """Better: the worst or the number falls by a part, or more limits are active."""

    def violations(worst, count):
        sizes = np.where(np.arange(9) < count, worst, -INF)
        return Violations(sizes, np.ones(9, np.int8), np.full(9, -INF))

    def active(count):
        return WorkingSet((np.arange(9) < count).astype(np.int8), np.zeros(9, bool))

    monkeypatch.setattr(active_set, "PROGRESS", 0.5)
    monkeypatch.setattr(options, "PATIENCE", 2)
    progress = active_set._Progress()
    told = []
    for worst, count, size in (
        (1.0, 8, 1),
        (0.9, 8, 1),  # not by half
        (0.4, 8, 1),  # by more
        (0.4, 5, 1),
        (0.4, 3, 1),  # by more than half of eight, not of five
        (0.4, 1, 1),  # by more than half of three
        (0.4, 1, 1),
        (0.4, 1, 1),
        (0.9, 9, 1),
        (0.9, 9, 2),  # one more is active
        (0.3, 9, 2),
        (0.3, 9, 1),
    ):
        progress.note(violations(worst, count), active(size))
        told.append(progress.stalled)
    stalls = [4, 7, 11]
    assert [n for n, stalled in enumerate(told) if stalled] == stalls


def test_peaks_are_those_of_a_filter_over_six_neighbours():
    """With plateaus; around the patient the last spoke is beside the first."""
    sizes = np.random.default_rng(0).integers(0, 4, (2, 6, 9, 7)).astype(float)
    cross = generate_binary_structure(3, 1)[None]
    wrapped = np.pad(sizes, ((0, 0), (0, 0), (1, 1), (0, 0)), mode="wrap")
    largest = maximum_filter(wrapped, footprint=cross)[:, :, 1:-1]
    np.testing.assert_array_equal(
        active_set._peak(sizes), (sizes > 0) & (sizes == largest)
    )


def test_links_of_every_field_join_by_their_peaks():
    shape = (3, 2, 2)
    problem = SimpleNamespace(shape=shape, alone=False, links_along_spokes=False)
    links = np.full((2, *shape), -INF)
    links[0, :, 0, 0], links[1, :, 1, 1] = [0.1, 0.3, 0.2], [0.5, 0.4, 0.5]
    n = links.size
    found = Violations(np.full(n, -INF), np.ones(n, np.int8), links.reshape(-1))
    chosen = active_set._chosen(
        cast(active_set.LimitedProblem, problem), found, WorkingSet.empty(n)
    )
    assert sorted(chosen.links[chosen.links > 0.0]) == [0.3, 0.5, 0.5]


def test_how_exactly_working_sets_are_solved(monkeypatch):
    """Roughly on the way, by the worst violation; the last one to the end."""
    n, script = 400, list[tuple[int, float, int | None]]()
    nothing = np.full(n, -INF)
    told = []

    class Scripted:
        """Violations come as written: number, size, limits of a prediction."""

        def __init__(self, problem, *_):
            self.limits, self.p = problem.limits, nothing
            self.active = WorkingSet.empty(n)

        @property
        def over(self):
            return not script

        def predicted(self, _):
            if self._following is None:
                return None
            bounds = (np.arange(n) < self._following).astype(np.int8)
            return WorkingSet(bounds, np.zeros(n, bool))

        def solve(self, active, rtol):
            self.active = active
            told.append((rtol, active.count))
            count, size, self._following = script.pop(0)
            sizes = np.where(np.arange(n) >= n - count, size, -INF)
            return Violations(sizes, np.ones(n, np.int8), nothing)

    monkeypatch.setattr(options, "PATIENCE", 2)
    monkeypatch.setattr(options, "SUBPROBLEM_ACCURACY", 1e-2)
    monkeypatch.setattr(active_set, "ActiveSetIteration", Scripted)
    free = np.full(n, INF)
    limits = SpokeLimits((n, 1, 1), -free, free, np.zeros(n, bool), -free, {})
    problem = SimpleNamespace(
        limits=limits, shape=(n, 1, 1), alone=True, links_along_spokes=False,
        objective=lambda _: 0.0,
    )  # fmt: skip

    def asked(*lines):
        script[:] = lines
        told.clear()
        given = cast(active_set.LimitedProblem, problem)
        active_set.primal_dual_active_set(given, None, 1e-6, Accuracy(1e-9))
        return told

    # by the worst violation, 1e-3 at most; to the end with none left
    plain = asked((8, 0.5, None), (6, 0.02, None), (0, 0.0, None), (0, 0.0, None))
    assert [rtol for rtol, _ in plain] == pytest.approx([1e-3, 1e-3, 2e-4, 1e-9])
    # the set that a model predicts, where there is one
    guided = asked((9, 0.5, 200), (9, 0.5, 300), (4, 0.02, 304), (2, 0.5, 150))
    assert guided[1:] == [(1e-3, 200), (1e-3, 300), (2e-4, 304)]
    # stalled: the same to the end first, and only then the safeguard
    stuck = asked(*[(3, 0.5, None)] * 8)
    assert stuck == [
        *zip([1e-3] * 5, [0, 3, 0, 3, 0], strict=True),
        *zip([1e-9] * 3, [0, 3, 0], strict=True),
    ]


def test_what_joins_is_a_share_of_the_worst_around(monkeypatch):
    """The smaller the worst of all, the more joins."""
    monkeypatch.setattr(options, "SHARE", 0.5)
    monkeypatch.setattr(options, "NEIGHBOURHOOD", 1)
    profile = np.array([1.0, 0.6, 0.2, 0.07, 0.0, 0.3]).reshape(1, 6, 1, 1)
    joins = {
        1.0: [True, True, False, False, False, True],
        0.05: [True, True, True, True, False, True],  # a quarter instead of a half
        0.08: [True, True, False, False, False, True],  # 0.4 instead of 0.5
    }
    for size, expected in joins.items():
        assert active_set._strong(size * profile).reshape(-1).tolist() == expected


@pytest.mark.parametrize("reach", [1, 2, 3])
def test_around_is_so_many_voxels_each_way(reach, monkeypatch):
    """Also past the last spoke, not past the ends of the patient, nor of a field."""
    shape = (2, 9, 10, 9)
    sizes = np.random.default_rng(reach).uniform(0.1, 1.0, shape)
    expected = np.zeros(shape, bool)
    ends = [range(n) for n in shape]
    for field, i, j, k in itertools.product(*ends):
        worst = max(
            sizes[field, a, b % shape[2], c]
            for a in range(max(i - reach, 0), min(i + reach, shape[1] - 1) + 1)
            for b in range(j - reach, j + reach + 1)
            for c in range(max(k - reach, 0), min(k + reach, shape[3] - 1) + 1)
        )
        expected[field, i, j, k] = sizes[field, i, j, k] >= 0.75 * worst
    monkeypatch.setattr(options, "SHARE", 0.75)
    monkeypatch.setattr(options, "NEIGHBOURHOOD", reach)
    np.testing.assert_array_equal(active_set._strong(sizes), expected)
