"""Laws over (sums of squares or penalties) × limits: the same optimum as Clarabel's.

Measurements contest the limits, so that these are active; every answer is verified by
the residuals that `fit` computes.
"""

import pytest

import ttus_opt as tt
from tests.solvers.dual.user_limits import Within, contested
from tests.solvers.own_terms import AlongZ, DepthWeighted, Differences, SkinGraph
from tests.solvers.test_algebraic import Ridge
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.terms.laplace import LaplaceTerm, SparseSourcesTerm

SCENE = contested(3, (5, 9, 5), scale=-1.0, noise=1.0, n_poses=8)
FORCE = tt.terms.ForceTerm(SCENE, 1.0)

OBJECTIVES = {
    "Tikhonov": lambda s: [LaplaceTerm(s), tt.terms.TikhonovTerm(s, 0.1), FORCE],
    "depth weighted": lambda s: [LaplaceTerm(s), DepthWeighted(s, 1.0), FORCE],
    "along z": lambda s: [LaplaceTerm(s), AlongZ(s, 1.0), FORCE],
    "skin graph": lambda s: [LaplaceTerm(s), SkinGraph(s, 1.0), FORCE],
    "differences alone": lambda s: [Differences(s, 1.0), FORCE],
    "ridge alone": lambda s: [Ridge(s, 0.1), FORCE],
    "robust": lambda s: [LaplaceTerm(s), tt.terms.RobustForceTerm(s, 1.0)],
    "sparse sources": lambda s: [SparseSourcesTerm(s, 0.1), FORCE],
    "total variation": lambda s: [tt.terms.TotalVariationTerm(s, 0.1), FORCE],
}
LIMITS = {
    "sign": lambda s: [HardBoundary(s), Sign(s)],
    "growth": lambda s: [HardBoundary(s), Sign(s), tt.constraints.Monotone(s)],
    "bounds": lambda s: [HardBoundary(s), Within(s, *_box(s))],
}


def _box(scene):
    """Narrow around the Laplace field."""
    field = scene.laplace.solve(scene.b)
    return field - 0.02, field + 0.02


def own_solver(formulation):
    """The structured one that takes it."""
    kinks = {"robust_force", "sparse_sources", "total_variation"}
    names = {term.name for term in formulation.terms}
    if names & kinks or "laplace" not in names:
        return "augmented_lagrangian"
    return "normal_equations"


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("objective", OBJECTIVES)
def test_the_optimum_within_limits_is_clarabels(objective, limits):
    declared = tt.Formulation(OBJECTIVES[objective](SCENE), LIMITS[limits](SCENE))
    own = tt.fit(SCENE, declared, solver=own_solver(declared))
    peer = tt.fit(SCENE, declared, solver="clarabel")
    assert own.status is tt.Status.SOLVED, own.advice
    # Clarabel's own answer may end a little above the tolerance
    assert peer.kkt is not None and peer.kkt.worst_relative < 5e-6
    assert own.objective == pytest.approx(peer.objective, rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("limits", LIMITS)
def test_limits_are_active_in_these_laws(limits):
    free = tt.Formulation(OBJECTIVES["Tikhonov"](SCENE), [HardBoundary(SCENE)])
    held = tt.Formulation(OBJECTIVES["Tikhonov"](SCENE), LIMITS[limits](SCENE))
    solver = "normal_equations"
    without = tt.fit(SCENE, free, solver=solver).objective
    assert tt.fit(SCENE, held, solver=solver).objective > without * (1.0 + 1e-4)
