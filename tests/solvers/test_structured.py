"""The structured solver against a direct factorisation and the closed form."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import (
    dragged_scene,
    ellipsoid,
    presses,
    small_scene,
    torso,
    with_wrenches,
)
from tests.oracles.dense import minimiser
from tests.solvers.dual.user_limits import Rows, louder
from ttus_opt.benchmark import reference_cases
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem import formulation
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.structured import Structured

STRUCTURED = registry.solvers()["structured"]
TIGHT = Request(tolerance=1e-8)


def program(scene, weight, hard=False):
    declared = formulation.load(
        "eq10", scene, force_weight=weight, torque_weight=0.5 * weight
    )
    if hard:
        declared = declared.with_constraints(tt.constraints.HardBoundary(scene))
    return declared.compile()


def relative(a, b):
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def solved(loaded):
    return STRUCTURED.prepare(loaded, TIGHT).solve()


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("weight", [1e-6, 1e-2, 1e2])
def test_equals_direct_least_squares(scene, weight, hard):
    loaded = program(scene, weight, hard)
    assert relative(solved(loaded).x, minimiser(loaded)) < 1e-8


def test_weight_zero_is_laplace_only(scene):
    x = solved(program(scene, 0.0)).x
    np.testing.assert_allclose(x, scene.laplace.solve(scene.b), atol=1e-12)


@pytest.mark.slow
def test_a_new_solve_reuses_and_agrees_with_a_fresh_one():
    """New values, boundary and weights need few or no new directions.

    Images of kept directions are as exact as the solve they come from asked for. What
    that leaves for another right-hand side takes one round of refinement, and here one
    direction: so many more than a fresh solve there may be, for a single change.
    """
    scene = small_scene("trilinear", (16, 32, 20), n_poses=40)
    prepared = STRUCTURED.prepare(program(scene, 1.0), TIGHT)
    first = prepared.solve().iterations
    noise = np.random.default_rng(5).normal(size=scene.f.shape)
    changes = {
        "the same again": scene,
        "boundary": scene.with_boundary(3.0, 1.0),
        "measured values": with_wrenches(scene, scene.f + noise),
    }
    of_kept, of_fresh = 0, 0
    for what, other in changes.items():
        for weight in (1.0, 0.3):
            loaded = program(other, weight)
            prepared.update(loaded)
            again = prepared.solve()
            fresh = solved(loaded)
            assert relative(again.x, fresh.x) < 1e-8, what
            assert again.iterations <= fresh.iterations + 1, what
            of_kept += again.iterations
            of_fresh += fresh.iterations
    assert of_kept < 0.8 * of_fresh  # without what is kept it would be all of them
    prepared.update(program(scene, 1.0))
    assert prepared.solve().iterations < first / 2


def test_another_trajectory_is_taken(scene):
    prepared = STRUCTURED.prepare(program(scene, 1e-2), TIGHT)
    prepared.solve()
    longer = tt.Scene.assemble(
        scene.voxmap,
        scene.shell,
        presses(scene.voxmap.surface, 20, np.random.default_rng(9)),
        sampling=scene.sampling,
    )
    prepared.update(program(longer, 1e-2))
    expected = minimiser(program(longer, 1e-2))
    assert relative(prepared.solve().x, expected) < 1e-8


def test_directions_grow_slowly_with_the_weight():
    """1e-6 to 1e2 are eight decades; plain CG would need hundreds of steps."""
    scene = small_scene("trilinear", (16, 32, 20), n_poses=40)
    steps = {w: solved(program(scene, w)).iterations for w in (1e-6, 1e-2, 1e2)}
    rows = 6 * 40
    assert steps[1e-6] <= steps[1e-2] <= steps[1e2] < rows / 2


def rough_surface(seed):
    """Spikes and dents from voxel to voxel: pockets, necks, slices one voxel thin."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.05, 0.1, (24, 12))
    return tt.Surface.from_radius(radius, np.linspace(0.0, 0.2, 12))


@pytest.mark.parametrize(
    ("surface", "shape", "r_outer"),
    [
        (torso(), (9, 20, 10), float(torso().radius.max())),
        (rough_surface(0), (10, 24, 12), None),
        (rough_surface(1), (12, 24, 12), float(rough_surface(1).radius.max())),
        (torso(), (9, 21, 3), None),
        (torso(), (4, 4, 3), None),
    ],
    ids=["touches the edge", "pockets", "pockets at the edge", "one slice", "tiny"],
)
def test_geometry_that_breaks_careless_solvers(surface, shape, r_outer):
    voxmap = tt.Voxmap.from_surface(surface, shape=shape, r_inner=0.03, r_outer=r_outer)
    shell = ellipsoid()
    trajectory = presses(surface, 10, np.random.default_rng(2), depth=0.015)
    scene = tt.Scene.assemble(voxmap, shell, trajectory, sampling="trilinear")
    for hard in (False, True):
        loaded = program(scene, 1e-1, hard)
        assert relative(solved(loaded).x, minimiser(loaded)) < 1e-8


@pytest.mark.parametrize("name", ["total_variation", "robust"])
def test_refuses_what_it_cannot_take(scene, name):
    declared = formulation.load(name, scene).compile()
    with pytest.raises(tt.TtusError, match="structured cannot take this problem"):
        STRUCTURED.prepare(declared, TIGHT)


def test_says_what_it_cannot_take():
    scene = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
    alone = formulation.Formulation([tt.terms.TikhonovTerm(scene)])
    assert STRUCTURED.refusal(alone.compile()) == "it needs a Laplace term"
    rows = Rows(scene, sp.csr_array(scene.N), scene.f - 1.0, scene.f + 1.0)
    limited = formulation.load("eq10", scene).with_constraints(rows)
    told = STRUCTURED.refusal(limited.compile())
    assert "bounds and growth along spokes" in told


def test_takes_as_many_unknowns_beside_the_field_as_it_says():
    scene = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
    for sectors, told in ((64, ""), (65, "it takes at most 64 unknowns beside")):
        declared = formulation.load("viscous_drag", scene, sectors=sectors)
        assert STRUCTURED.refusal(declared.compile()).startswith(told)
        assert bool(STRUCTURED.refusal(declared.compile())) == bool(told)


def test_never_forms_q():
    """Peak size: nothing with more entries than L and the measured rows have."""
    scene = small_scene("trilinear", (16, 32, 20), n_poses=40)
    assert isinstance(scene.laplace, LaplaceSystem)
    Q, _ = program(scene, 1.0).normal_equations()
    prepared = STRUCTURED.prepare(program(scene, 1.0), TIGHT)
    prepared.solve()
    held = [v for v in vars(prepared._solver.system).values() if sp.issparse(v)]
    assert max(M.nnz for M in held) < Q.nnz / 2


@pytest.mark.slow
def test_a_weight_beyond_single_precision_is_no_crash():
    """1e8 times what is usual: the preconditioner errs, residuals must not run away."""
    case = reference_cases("S")[0].perturbed("noise")
    weights = {"force_weight": 1e6, "torque_weight": 1e6}
    loaded = formulation.load("eq10", case.scene(), **weights).compile()
    candidate = STRUCTURED.prepare(loaded, Request(1e-6, 60.0)).solve()
    assert np.isfinite(candidate.x).all()
    residuals = kkt_residuals(loaded, candidate.x, candidate.duals)
    assert residuals.worst_relative <= 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "name"),
    [
        pytest.param("noise", "coulomb_drag", marks=pytest.mark.long),
        ("reversed", "eq10_sign_monotone"),
    ],
)
def test_contested_limits_of_a_third_of_a_million_voxels(how, name):
    """Weights 1e4 times too large, voxel-mean rows: K at its largest; a minute each."""
    case = reference_cases("M")[0].sampled("voxel-mean").perturbed(how)
    weights = {"force_weight": 100.0, "torque_weight": 100.0}
    loaded = formulation.load(name, case.scene(), **weights).compile()
    candidate = STRUCTURED.prepare(loaded, Request(1e-6, 400.0)).solve()
    assert candidate.claim is Claim.DONE, candidate.detail
    residuals = kkt_residuals(loaded, candidate.x, candidate.duals)
    assert residuals.worst_relative <= 1e-6


def test_auto_leaves_terms_over_all_voxels_to_the_normal_equations():
    """Tikhonov's term once went to a splitting method, two hundred times slower."""
    scene = small_scene("trilinear", shape=(12, 36, 15))
    chosen = {
        name: registry.choose("auto", formulation.load(name, scene).compile()).name
        for name in ("eq10", "tikhonov")
    }
    assert chosen == {"eq10": "structured", "tikhonov": "normal_equations"}


def test_limits_and_a_second_field_cost_more():
    """What "auto" weighs: in proportion to the voxels beside a small constant."""
    cost = {}
    for n, shape in (("few", (7, 14, 8)), ("many", (12, 36, 15))):
        scene = small_scene("trilinear", shape=shape)
        for name in ("eq10", "eq10_sign", "coulomb_drag"):
            declared = formulation.load(name, scene).compile()
            cost[name, n] = STRUCTURED.cost(declared)
    for n in ("few", "many"):
        assert 0.0 < cost["eq10", n] < cost["eq10_sign", n] < cost["coulomb_drag", n]
    for name in ("eq10", "eq10_sign", "coulomb_drag"):
        # seconds of one core, of five thousand voxels
        assert cost[name, "few"] < cost[name, "many"] < 2.0


@pytest.mark.parametrize("name", ["eq10_sign_monotone", "coulomb_drag"])
def test_a_start_at_the_answer_needs_no_working_set_but_its_own(name):
    """One field's bounds and links, or two fields'."""
    drag = name == "coulomb_drag"
    scene = dragged_scene("contact", shape=(7, 14, 8)) if drag else small_scene()
    scene = louder(scene, 1, scale=-3.0)
    more = {"largest_friction": 0.1} if drag else {}
    declared = formulation.load(
        name, scene, force_weight=1.0, torque_weight=1.0, **more
    )
    loaded, request = declared.compile(), Request(1e-6)
    solver = Structured()
    cold = solver.prepare(loaded, request).solve()
    warm = solver.prepare(loaded, request)
    warm.start_at(cold.x, cold.duals)
    found = warm.solve()
    np.testing.assert_allclose(found.x, cold.x, atol=1e-5 * np.abs(cold.x).max())
    # one solved loosely, and again to the tolerance
    assert found.detail.startswith("2 working sets")
    assert found.iterations < cold.iterations
    # with no multipliers of bounds the field alone is a start
    warm.start_at(cold.x, replace(cold.duals, bounds=None))
    assert relative(warm.solve().x, cold.x) < 1e-4
