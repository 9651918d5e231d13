"""Normal equations against a direct factorisation, and how their steps grow."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import small_scene
from tests.oracles.dense import minimiser
from tests.solvers.own_terms import OWN, AlongZ, DepthWeighted, Differences
from ttus_opt.benchmark import reference_cases
from ttus_opt.benchmark.cases import with_new_values
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.problem.terms.departures import TikhonovTerm
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.normal_equations import NormalEquations

SCENE = small_scene("trilinear")

#: Every term of more rows than these is wide here, as on full grids
SOLVER = NormalEquations(few_rows=100)
TERMS = (TikhonovTerm, *OWN)


def declared(scene, weight=1e-2, hard=False):
    weights = {"force_weight": weight, "torque_weight": 0.5 * weight}
    return load("eq10_hard_boundary" if hard else "eq10", scene, **weights)


def solved(program, tolerance=1e-8):
    return SOLVER.prepare(program, Request(tolerance)).solve()


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("own", TERMS, ids=lambda term: term.name)
def test_equals_a_factorisation(own, hard):
    for weight in (1e-4, 1.0):
        program = (declared(SCENE, 1e-2, hard) + own(SCENE, weight)).compile()
        expected = minimiser(program)
        found = solved(program, 1e-10)
        assert found.claim is Claim.DONE
        apart = np.linalg.norm(found.x - expected) / np.linalg.norm(expected)
        assert apart < 1e-7
        residuals = kkt_residuals(program, found.x, found.duals)
        assert residuals.worst_relative < 1e-9


@pytest.mark.parametrize("name", ["anisotropic", "screened", "volume_weighted"])
def test_takes_another_operator_with_a_wide_term(name):
    weights = {"force_weight": 0.1, "torque_weight": 0.1}
    program = (load(name, SCENE, **weights) + AlongZ(SCENE, 0.01)).compile()
    found = solved(program, 1e-10)
    np.testing.assert_allclose(found.x, minimiser(program), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("own", [TikhonovTerm, DepthWeighted], ids=lambda t: t.name)
def test_steps_stay_few_over_twelve_decades(own):
    """Of the term; of the measured rows, too, up to what single precision holds."""
    counts = []
    for weight in 10.0 ** np.arange(-6, 7, 3):
        counts.append(solved((declared(SCENE) + own(SCENE, weight)).compile(), 1e-6))
    for weight in (1e-6, 1e-3, 1.0, 1e3, 1e5):
        counts.append(
            solved((declared(SCENE, weight) + own(SCENE, 1e-3)).compile(), 1e-6)
        )
    assert all(c.claim is Claim.DONE for c in counts)
    assert max(c.iterations for c in counts) <= 60


@pytest.mark.parametrize("own", OWN, ids=lambda term: term.name)
def test_steps_stay_few_where_own_terms_are_up_to_the_prior(own):
    for weight in (1e-6, 1e-3, 1.0):
        found = solved((declared(SCENE) + own(SCENE, weight)).compile(), 1e-6)
        assert found.iterations <= 50


@pytest.mark.slow
@pytest.mark.parametrize("own", TERMS, ids=lambda term: term.name)
def test_steps_from_s_to_m(own):
    counts = []
    for case in reference_cases("S,M"):
        scene = case.scene()
        program = (declared(scene) + own(scene, 1e-3)).compile()
        found = solved(program, 1e-6)
        residuals = kkt_residuals(program, found.x, found.duals)
        assert residuals.worst_relative < 1e-6
        counts.append(found.iterations)
    assert counts[1] <= counts[0] + 8


def test_other_values_and_weights_are_taken():
    first = (declared(SCENE) + TikhonovTerm(SCENE, 1e-3)).compile()
    loaded = SOLVER.prepare(first, Request(1e-9))
    loaded.solve()
    other = with_new_values(SCENE, 3)
    second = (declared(other, 0.3) + TikhonovTerm(other, 0.1)).compile()
    loaded.update(second)
    np.testing.assert_allclose(loaded.solve().x, minimiser(second), atol=1e-6)


@pytest.mark.slow
def test_noisy_and_contradictory_measurements():
    for how in ("noise", "reversed"):
        case = replace(reference_cases("S")[0].small(), name="XS").perturbed(how)
        scene = case.scene()
        program = (declared(scene, 1.0) + TikhonovTerm(scene, 1e-3)).compile()
        found = solved(program, 1e-6)
        residuals = kkt_residuals(program, found.x, found.duals)
        assert residuals.worst_relative < 1e-6


def test_limits_that_contradict_each_other():
    far = (declared(SCENE) + TikhonovTerm(SCENE)).with_constraints(
        HardBoundary(SCENE), Monotone(SCENE, 1e6)
    )
    found = SOLVER.prepare(far.compile(), Request(1e-6)).solve()
    assert found.claim is Claim.INFEASIBLE


def test_says_what_it_does_not_take():
    alone = Formulation([TikhonovTerm(SCENE)]).compile()
    assert "Laplace term" in SOLVER.refusal(alone)
    drag = load("viscous_drag", SCENE).compile()
    assert "unknowns beside the field" in SOLVER.refusal(drag)
    robust = load("robust", SCENE).compile()
    assert "not a sum of squares" in SOLVER.refusal(robust)


def test_out_of_time_it_says_so():
    program = (declared(SCENE) + TikhonovTerm(SCENE, 1e-3)).compile()
    found = SOLVER.prepare(program, Request(1e-6, 1e-9)).solve()
    assert found.claim is Claim.TIME_LIMIT


@pytest.mark.slow
def test_heavy_differences_leave_constants_to_soft_values():
    """Screening at every voxel would hold them: 222 steps where 72 will do."""
    scene = small_scene("trilinear", (12, 36, 15))
    program = (declared(scene) + Differences(scene, 1e3)).compile()
    found = solved(program, 1e-6)
    assert found.claim is Claim.DONE and found.iterations < 110
