"""Gaussian-process regression against dense algebra and general solvers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tests.kit import InputError, small_scene
from tests.oracles.dense import stacked
from ttus_opt import fit
from ttus_opt.gaussian import prior as prior_file
from ttus_opt.gaussian.prior import partial_root, square_root
from ttus_opt.problem.constraints.signs import Sign, ViscousSign
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.depth_map import DepthMapTerm
from ttus_opt.problem.terms.depth_profile import DepthProfile
from ttus_opt.problem.terms.drag import Viscous
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers import algebraic, covariance
from ttus_opt.solvers.base import Request


def scene():
    return small_scene("trilinear", (7, 12, 8), 20)


def declared(weight=10.0):
    prior = DepthMapTerm(
        scene(), 2.0, DepthProfile((1.0,), (2.0,)), surface_length=0.06
    )
    return Formulation(
        terms=[prior, ForceTerm(scene(), weight), TorqueTerm(scene(), weight)]
    )


def test_parameters_within_bounds_agree_with_bounded_least_squares():
    at_bound = []
    for seed in range(4):
        own = small_scene("trilinear", (5, 10, 6), 16, seed)
        prior = DepthMapTerm(own, 1.0, DepthProfile((1.0,), (2.0,)))
        drag = ForceTerm(own, 50.0, drag=Viscous(own, "reference"))
        formulation = Formulation(
            terms=[prior, drag], constraints=[ViscousSign(own, 1)]
        )
        program = formulation.compile()
        M, t = stacked(program)
        expected = lsq_linear(M.toarray(), t, program.box, method="bvls")
        candidate = covariance.Covariance().prepare(program, Request()).solve()
        x, size = candidate.x, np.abs(expected.x).max()
        assert np.abs(x - expected.x).max() < 1e-7 * size
        kkt = kkt_residuals(program, x, candidate.duals, tolerance=1e-9)
        assert kkt.worst_relative < 1e-9
        at_bound.append(bool(expected.x[-1] <= 0.0))
    assert set(at_bound) == {True, False}


def test_rows_may_be_fewer_or_more_than_the_voxels_they_touch():
    for n_poses in (2, 60):
        own = small_scene("trilinear", (7, 12, 8), n_poses)
        prior = DepthMapTerm(own, 1.0, DepthProfile((1.0,), (2.0,)))
        force = ForceTerm(own, 100.0)
        solution = fit(own, Formulation(terms=[prior, force]), solver="covariance")
        assert solution.status.name == "SOLVED"
        touched = len(np.unique(own.N.indices))
        assert (touched < len(own.f)) == (n_poses == 60)


@pytest.mark.parametrize("rank", [40, 12])
def test_the_square_root_leaves_out_what_is_rounding(rank):
    rng = np.random.default_rng(1)
    half = rng.normal(size=(40, rank)) * np.logspace(0, -3, rank)
    matrix = half @ half.T
    root = square_root(matrix)
    assert root.shape == (40, rank)
    np.testing.assert_allclose(root @ root.T, matrix, atol=1e-13 * matrix.max())


@pytest.mark.parametrize("neglected", [1e-2, 1e-6])
def test_a_partial_root_leaves_what_may_be_neglected(neglected, monkeypatch):
    monkeypatch.setattr(prior_file, "PIVOTS", 7)
    rng = np.random.default_rng(1)
    half = rng.normal(size=(80, 60)) * np.logspace(0, -5, 60)
    matrix = half @ half.T
    root = partial_root(np.diag(matrix), lambda some: matrix[:, some], neglected)
    rest, most = matrix - root @ root.T, np.diag(matrix).max()
    assert np.linalg.eigvalsh(rest).min() > -1e-12 * most
    assert 0.01 * neglected * most < np.diag(rest).max() <= neglected * most
    assert root.shape[1] <= 1.3 * square_root(matrix, neglected).shape[1]
    assert partial_root(np.zeros(5), lambda some: matrix, neglected).shape == (5, 0)


@pytest.mark.parametrize(("weight", "factors"), [(1.0, 1), (1e9, 2)])
def test_accurate_measurements_take_a_factor_that_neglects_less(
    weight, factors, monkeypatch
):
    own = small_scene("trilinear", (12, 24, 12), 60)
    profile, lengths = DepthProfile((1.0,), (2.0,)), (0.4, 0.2, 0.05)
    prior = DepthMapTerm(own, 1.0, profile, *lengths)
    program = Formulation(terms=[prior, ForceTerm(own, weight)]).compile()
    ranks = []
    monkeypatch.setattr(covariance, "MOST_STEPS", 12)
    monkeypatch.setattr(
        covariance,
        "partial_root",
        lambda *given: ranks.append(partial_root(*given)) or ranks[-1],
    )
    x = covariance.Covariance().prepare(program, Request()).solve().x
    sizes = [root.shape[1] for root in ranks]
    assert len(sizes) == factors and sorted(set(sizes)) == sizes
    monkeypatch.setattr(covariance, "NEGLECTED", (1e-15,))
    exact = covariance.Covariance().prepare(program, Request()).solve().x
    assert np.abs(x - exact).max() < 1e-8 * np.abs(exact).max()


def test_it_says_what_it_does_not_take():
    signed = Formulation(terms=declared().terms, constraints=[Sign(scene())])
    with pytest.raises(InputError, match="no bounds of the field"):
        fit(scene(), signed, solver="covariance")
    with pytest.raises(InputError, match="whose covariance is known"):
        fit(scene(), "eq10", solver="covariance")


@pytest.mark.parametrize(("voxels", "touched"), [(51_840, 200), (604_800, 39_999)])
def test_auto_prefers_it_to_algebraic_as_long_as_it_takes_a_program(
    voxels, touched, monkeypatch
):
    """Of 345,600 voxels, 6,800 touched: 6 s, `algebraic` has no answer after 400 s."""
    sizes = SimpleNamespace(of=lambda program: SimpleNamespace(voxels=voxels))
    monkeypatch.setattr(algebraic, "Sizes", sizes)
    monkeypatch.setattr(covariance, "_touched", lambda *_: np.arange(touched))
    program = SimpleNamespace(known_prior=SimpleNamespace(target=np.zeros(voxels)))
    here, there = (
        one.cost(program) for one in (*covariance.SOLVERS, *algebraic.SOLVERS)
    )
    assert here < there and touched < covariance.LARGEST


@pytest.mark.parametrize("solver", ["covariance", "auto"])
def test_it_refuses_what_would_not_fit_in_memory(solver, monkeypatch):
    """Nor does "auto" take one that would run for hours at tens of GiB."""
    monkeypatch.setattr(covariance, "LARGEST", 10)
    with pytest.raises(InputError, match=r"touch 10 voxels at most.*a coarser grid"):
        fit(scene(), declared(), solver=solver)


def test_auto_takes_another_where_size_is_not_why_it_is_refused(monkeypatch):
    monkeypatch.setattr(covariance, "LARGEST", 10)
    signed = Formulation(terms=declared().terms, constraints=[Sign(scene())])
    assert fit(scene(), signed).solver != "covariance"
    assert fit(scene(), "eq10").solver != "covariance"


def test_algebraic_says_that_it_is_not_for_many_voxels_of_a_depth_map(monkeypatch):
    fit(scene(), declared(), solver="algebraic")
    monkeypatch.setattr(algebraic, "MOST_KNOWN", 600)
    with pytest.raises(
        InputError, match=r"600 voxels at most.*are 672: use covariance"
    ):
        fit(scene(), declared(), solver="algebraic")
