"""Fits as a whole: what is handed out, and what is not."""

import functools
import pickle
import time
from dataclasses import dataclass, replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, dragged_scene, refuses, small_scene
from ttus_opt.fitting import batch
from ttus_opt.fitting.batch import Fitter, _better, fit, judged
from ttus_opt.fitting.weights import weight_choice
from ttus_opt.fitting.weights.weight_choice import WeightChoice
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.solution import Status, Timings
from ttus_opt.problem.terms.laplace import LaplaceTerm, SparseSourcesTerm
from ttus_opt.problem.terms.wrench import ForceTerm
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.base import Candidate, Claim, Request

SCENE = small_scene("trilinear")
TINY = small_scene("trilinear", shape=(6, 8, 5), n_poses=15)
TIMES = Timings(0.0, 0.0, 0.0)


def eq10(weight=0.1, scene=SCENE):
    return Formulation([LaplaceTerm(scene), ForceTerm(scene, weight)], name="mine")


@functools.cache
def dense_minimum(weight, tiny=False):
    scene = TINY if tiny else SCENE
    L, N = scene.L.toarray(), scene.N.toarray()
    return np.linalg.solve(
        L.T @ L + weight * N.T @ N, L.T @ scene.b + weight * N.T @ scene.f
    )


def judge(x, claim=Claim.DONE, scene=SCENE):
    declared = eq10(scene=scene)
    return judged(
        declared,
        reduce(declared.compile()),
        "by hand",
        Candidate(x, Duals(), 3, claim, "words"),
        Request(1e-6),
        TIMES,
    )


def test_the_answer_is_the_dense_minimum():
    solution = fit(SCENE, eq10())
    np.testing.assert_allclose(
        solution.field.values.reshape(-1), dense_minimum(0.1), atol=1e-8
    )
    assert solution.status is Status.SOLVED
    assert solution.kkt.worst_relative < 1e-6
    assert solution.objective == pytest.approx(sum(solution.costs.values()))
    assert solution.field.provenance["formulation"] == str(eq10())
    told = {"assembly", "setup", "solve", "compile"}
    assert set(solution.timings.as_dict()) == told


def test_no_claim_takes_what_is_not_finite_for_an_answer():
    x = dense_minimum(0.1)
    for huge in (1e155, -1e155, 1e200):
        assert judge(np.full(SCENE.n_voxels, huge)).status is Status.INACCURATE
    declared = eq10().with_constraints(Sign(SCENE))
    reduction, nan = reduce(declared.compile()), np.full(SCENE.n_voxels, np.nan)
    for duals in (Duals({}, nan), Duals({"sign": nan}), Duals(terms={"force": nan})):
        for claim in (Claim.DONE, Claim.GAVE_UP):
            answer = Candidate(x, duals, 3, claim)
            solution = judged(
                declared, reduction, "by hand", answer, Request(1e-6), TIMES
            )
            assert solution.status is Status.INACCURATE
            assert solution.kkt.worst_relative == np.inf


def test_an_answer_is_not_solved_where_nothing_bounds_its_gap(monkeypatch):
    """Few squares, and a penalty that does not state its gauge: nothing bounds."""
    monkeypatch.setattr(tt.terms.Absolute, "gauge", tt.terms.Penalty.gauge)
    declared = load("sparse_sources", SCENE, force_weight=0.1)
    fitter = Fitter(declared, solver="clarabel")
    answer = fitter._prepared.solve()
    for claim, status in (
        (Claim.DONE, Status.INACCURATE),
        (Claim.DOUBTS, Status.INACCURATE),
        (Claim.GAVE_UP, Status.INACCURATE),
    ):
        found = judged(
            declared,
            reduce(declared.compile()),
            "by hand",
            replace(answer, claim=claim),
            Request(1e-6),
            TIMES,
        )
        assert not found.kkt.is_bound
        assert found.status is status, found.kkt
    assert "the residuals hold, but nothing bounds the gap" in found.detail


@pytest.mark.parametrize("place", ["target", "rows"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_term_that_is_no_number_is_refused_by_name(place, value):
    @dataclass(frozen=True)
    class Own(ForceTerm):
        name = "own_idea"

        def rows(self):
            rows = super().rows()
            target, matrix = rows.target.copy(), rows.blocks["p"].copy()
            if place == "target":
                target[4] = value
            else:
                matrix.data[0] = value
            return tt.AffineRows({"p": matrix}, target)

    declared = Formulation([LaplaceTerm(SCENE), Own(SCENE, 0.1)])
    for solver in ("auto", "structured", "clarabel"):
        with pytest.raises(InputError, match=rf"term own_idea .*: its {place}"):
            fit(SCENE, declared, solver=solver)


def test_auto_goes_on_where_the_first_answer_does_not_hold(monkeypatch):
    """And says so; a solver named by the user is not replaced."""
    from ttus_opt.solvers import structured

    assert fit(TINY, eq10(scene=TINY)).attempts == ()

    def gives_up(self):
        return Candidate(
            dense_minimum(0.5, tiny=True), claim=Claim.GAVE_UP, detail="tired"
        )

    monkeypatch.setattr(structured._Loaded, "solve", gives_up)
    solution = fit(TINY, eq10(scene=TINY))
    assert solution.status is Status.SOLVED
    assert solution.solver == "normal_equations"
    assert [a.solver for a in solution.attempts] == ["structured"]
    assert "after structured inaccurate at" in solution.advice
    np.testing.assert_allclose(
        solution.field.values.reshape(-1), dense_minimum(0.1, tiny=True), atol=1e-6
    )
    alone = fit(TINY, eq10(scene=TINY), solver="structured")
    assert alone.status is Status.INACCURATE
    assert alone.detail == "tired"


def test_of_two_answers_the_solved_one_is_kept_or_that_with_less_residual():
    exact = dense_minimum(0.1, tiny=True)
    near, far = (judge(exact + error, scene=TINY) for error in (1e-3, 1e-2))
    none = judge(None, Claim.GAVE_UP, TINY)
    assert near.status is far.status is Status.INACCURATE
    for one, other in ((near, far), (far, near), (none, near), (near, none)):
        assert _better(one, other) is near
    proved = replace(far, status=Status.SOLVED)
    assert _better(near, proved) is proved


def test_slack_and_dual_of_every_constraint_by_name():
    declared = eq10(3.0).with_constraints(Sign(SCENE), HardBoundary(SCENE))
    solution = fit(SCENE, declared)
    assert set(solution.slacks) == set(solution.duals_by_name) == {"sign", "boundary"}
    assert np.abs(solution.slacks["boundary"]).max() < 1e-6
    assert solution.slacks["sign"].min() > -1e-6
    # the multiplier of a boundary value is the price of moving it
    fixed = np.flatnonzero(~SCENE.laplace.free)
    dual = solution.duals_by_name["boundary"]
    row = int(np.argmax(np.abs(dual)))

    def minimum(shift):
        moved = SCENE.b.copy()
        moved[fixed[row]] += shift
        other = replace(SCENE, b=moved)
        terms = [LaplaceTerm(other), ForceTerm(other, 3.0)]
        return fit(
            other, Formulation(terms, [Sign(other), HardBoundary(other)])
        ).objective

    h = 1e-4
    price = (minimum(h) - minimum(-h)) / (2 * h)
    # the Laplace term's own identity row of that voxel moves along, at no cost
    assert price == pytest.approx(-dual[row], rel=1e-2)


@pytest.mark.parametrize("solver", ["structured", "closed_form", "clarabel"])
def test_solving_again_takes_the_new_data(solver):
    fitter = Fitter(eq10(), solver=solver)
    first = fitter.solve()
    assert first.timings.again is None
    fitter.update(eq10().with_weights(force=2.0))
    second = fitter.solve()
    assert second.timings.again > 0.0
    assert second.timings.solve == first.timings.solve
    np.testing.assert_allclose(
        second.field.values.reshape(-1), dense_minimum(2.0), atol=1e-5
    )
    assert "again" in second.timings.as_dict()


def test_terms_of_several_kinds_go_through_one_reduction():
    declared = eq10() + SparseSourcesTerm(SCENE, 0.01)
    solution = fit(SCENE, declared, tolerance=1e-5)
    assert set(solution.costs) == {"laplace", "force", "sparse_sources"}
    assert len(solution.candidate) == SCENE.n_voxels
    assert solution.field.values.shape == SCENE.voxmap.grid.shape


def test_what_cannot_be_fitted():
    other = replace(SCENE)
    refuses(InputError, "belongs to another scene", fit, other, eq10())
    with pytest.raises(InputError, match="force weight must not be negative"):
        fit(SCENE, "eq10", force_weight=-1.0)
    with pytest.raises(InputError, match="unknown solver 'structred', did you mean"):
        fit(SCENE, "eq10", solver="structred")
    for word in ("Auto", "chosen"):
        with pytest.raises(InputError, match=f"weights='{word}' is not known: take"):
            fit(SCENE, "eq10", weights=word)
    refuses(InputError, "tolerance must lie between", fit, SCENE, "eq10", tolerance=0.0)


def test_compiling_is_no_part_of_the_other_times():
    scene = replace(SCENE, seconds=2.0, compile_seconds=900.0)
    times = tt.fit(scene, "eq10").timings
    assert times.compile >= 900.0
    assert 2.0 <= times.assembly < 900.0
    assert times.as_dict()["compile"] == times.compile


def test_each_part_s_compiling_is_told_once(monkeypatch):
    """Every stopwatch that a fit with an estimated parameter starts is read once."""
    made = []

    class Watch:
        seconds, compile = 1.0, 100.0

        def __init__(self):
            made.append(self)

    monkeypatch.setattr(batch, "Stopwatch", Watch)
    scene = dragged_scene("contact", 0.0, 40.0, (7, 12, 8), n=30)
    found = fit(scene, "viscous_drag")
    assert found.standard_errors
    own = scene.compile_seconds
    assert found.timings.compile == pytest.approx(own + 100.0 * len(made))


def test_estimates_take_no_more_time_than_there_was():
    """Beside a fit without a search, ``search`` is the time of its standard errors."""
    scene = dragged_scene("contact")
    declared = load("viscous_drag", scene)
    fit(scene, declared, solver="structured")  # compiles, imports
    start = time.perf_counter()
    solution = fit(scene, declared, solver="structured")
    elapsed = time.perf_counter() - start
    assert 0.0 < solution.timings.search < elapsed


@pytest.mark.parametrize(("name", "seconds"), [("eq10", 1.0), ("viscous_drag", 2.0)])
def test_the_choice_of_weights_counts_as_search(name, seconds, monkeypatch):
    """With the time of standard errors, where there are any."""

    class Watch:
        seconds, compile = 1.0, 0.0

    scene = dragged_scene("contact", 0.0, 40.0, (7, 12, 8), n=30)
    choice = WeightChoice(scene, load(name, scene))
    monkeypatch.setattr(weight_choice, "choice_of", lambda *_: choice)
    monkeypatch.setattr(batch, "Stopwatch", Watch)
    found = fit(scene, name, weights="auto")
    assert bool(found.standard_errors) == (name == "viscous_drag")
    assert found.timings.search == seconds


@pytest.mark.parametrize("name", ["eq10", "total_variation"])
def test_a_fitter_goes_to_another_process(name):
    fitter = Fitter(load(name, TINY))
    copied = pickle.loads(pickle.dumps(fitter)).solve()
    assert copied.objective == fitter.solve().objective
