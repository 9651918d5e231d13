"""Penalties other than squares: known answers, and interior points on small scenes."""

import functools

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import small_scene
from tests.solvers.problems import program, term
from ttus_opt.problem import formulation
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.terms.departures import TotalVariationTerm
from ttus_opt.problem.terms.laplace import LaplaceTerm, SparseSourcesTerm
from ttus_opt.problem.terms.penalties import Absolute, Groups, Huber, Penalty
from ttus_opt.problem.terms.wrench import ForceTerm
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers import augmented_lagrangian, registry
from ttus_opt.solvers.base import Claim, Request

SOLVER = registry.solvers()["augmented_lagrangian"]


def solved(what, tolerance=1e-7):
    """The answer, its residuals checked on the declared program."""
    both = reduce(what)
    found = SOLVER.prepare(both.program, Request(tolerance, 60.0)).solve()
    point = both.restore(found.x, found.duals)
    kkt = kkt_residuals(what, point.x, point.duals)
    assert kkt.worst_relative <= 2.0 * tolerance, (kkt, found.detail)
    return point.x


@pytest.mark.slow
def test_a_step_keeps_its_edge_under_total_variation():
    """‖x − y‖² + w Σ |D x|, a step of 20 and 30: each side w/2n inwards."""
    y = np.repeat([0.0, 1.0], [20, 30])
    D = np.diff(np.eye(50), axis=0)
    x = solved(
        program(
            [term(np.eye(50), y), term(D, np.zeros(49), 2.0, Absolute(), name="bent")]
        ),
        1e-9,
    )
    expected = np.repeat([2.0 / 40, 1.0 - 2.0 / 60], [20, 30])
    np.testing.assert_allclose(x, expected, atol=1e-6)


def test_programs_of_squares_are_refused():
    assert "squares" in SOLVER.refusal(program([term(np.eye(1), [1])]))


def test_a_penalty_without_a_resolvent_is_refused():
    class Mute(Absolute):
        resolvent = Penalty.resolvent

    what = program([term(np.eye(1), [1], 1.0, Mute())])
    assert "does not implement resolvent()" in SOLVER.refusal(what)


class _Departure(tt.Term):
    """A penalty of p − p₀ over all voxels."""

    name = "departure"

    def rows(self):
        V = self.scene.n_voxels
        field = self.scene.laplace.solve(self.scene.b)
        return tt.AffineRows({"p": sp.csr_array(sp.eye_array(V, format="csr"))}, field)

    @property
    def penalty(self):
        return Absolute()


class _RobustPoses(ForceTerm):
    """Lengths of force residuals: an outlier is a pose."""

    @property
    def penalty(self):
        return Groups(3)


class _RobustSources(SparseSourcesTerm):
    @property
    def penalty(self):
        return Huber(0.01)


def _with_prior(term):
    def build(scene, weight):
        return [LaplaceTerm(scene), ForceTerm(scene, 1e-2), term(scene, weight)]

    return build


TERMS = {
    "poses": lambda s, w: [LaplaceTerm(s), _RobustPoses(s, w)],
    "sources": lambda s, w: [SparseSourcesTerm(s, w), ForceTerm(s, 1e-2)],
    "squares and sources": _with_prior(SparseSourcesTerm),
    "Huber's sources": _with_prior(_RobustSources),
    "variation": lambda s, w: [TotalVariationTerm(s, w), ForceTerm(s, 1e-2)],
    "squares and variation": _with_prior(TotalVariationTerm),
    "squares and lengths": _with_prior(lambda s, w: TotalVariationTerm(s, w, True)),
    "departure": _with_prior(_Departure),
}
LIMITS = {
    "free": lambda s: [tt.constraints.HardBoundary(s)],
    "sign": lambda s: [tt.constraints.HardBoundary(s), Sign(s)],
    "growth": lambda s: [tt.constraints.HardBoundary(s), Sign(s), Monotone(s)],
}


@functools.cache
def scene():
    return small_scene("trilinear", shape=(6, 12, 7), n_poses=8, seed=4)


def compared(terms, weight, limits):
    """The same objective as an interior point's."""
    members = TERMS[terms](scene(), weight)
    what = Program.build(scene(), members, LIMITS[limits](scene()))
    both = reduce(what)
    peer = "clarabel" if both.program.is_quadratic else "cvxpy_clarabel"
    reference = registry.solvers()[peer].prepare(both.program, Request(1e-8)).solve()
    assert reference.claim is Claim.DONE
    expected = what.objective(both.restore(reference.x, reference.duals).x)
    size = what.objective(np.zeros(what.n_variables))
    assert what.objective(solved(what, 1e-6)) == pytest.approx(
        expected, rel=2e-5, abs=1e-9 * size
    )


@pytest.mark.parametrize("terms", ["poses", "sources", "squares and variation"])
def test_interior_points_agree(terms):
    compared(terms, 1e-3, "free")


@pytest.mark.slow
@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("weight", [1e1, 1e-5])
@pytest.mark.parametrize("terms", TERMS)
def test_interior_points_agree_over_weights_and_limits(terms, weight, limits):
    compared(terms, weight, limits)


@pytest.mark.parametrize("weight", [1e4, 1e6])
def test_hubers_penalty_on_heavy_forces_is_an_interior_points(weight):
    """Contradictory forces beyond the kink: few Newton steps whatever they weigh."""
    scene = small_scene("trilinear", shape=(8, 16, 10), n_poses=12)
    weights = {"force_weight": weight, "torque_weight": weight}
    what = formulation.load("robust", scene, **weights).compile()
    both = reduce(what)
    found = SOLVER.prepare(both.program, Request(1e-7, 60.0)).solve()
    assert found.x is not None and found.iterations <= 12
    point = both.restore(found.x, found.duals)
    assert kkt_residuals(what, point.x, point.duals).worst_relative <= 1e-7
    other = tt.fit(scene, "robust", solver="clarabel", **weights)
    assert other.objective == pytest.approx(what.objective(point.x), rel=1e-7)


def test_the_longest_row():
    matrix = sp.csr_array([[3.0, 4.0], [0.0, 1.0], [4.5, 0.0]])
    assert augmented_lagrangian._longest(matrix) == 5.0
    assert augmented_lagrangian._longest(sp.csr_array((2, 3))) == 1.0
