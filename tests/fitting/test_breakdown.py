"""Solvers whose arithmetic breaks down."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import small_scene
from tests.refusals import refuses
from ttus_opt.core.errors import InputError, NumericalError
from ttus_opt.fitting.breakdown import Guarded
from ttus_opt.problem.formulation import load
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)

SCENE = small_scene("trilinear", shape=(6, 10, 6), n_poses=6)
PROGRAM = load("eq10", SCENE).compile()


@pytest.fixture
def ours(monkeypatch):
    """`Brittle` counts as the package's own, not as a user's."""
    monkeypatch.setattr("ttus_opt.core.plugins._is_users", lambda _: False)


class Brittle(Solver, Prepared):
    """Breaks where it is told to, and counts how often it was set up."""

    name, summary = "brittle", "breaks"
    capabilities = Capabilities(inequalities=True, equalities=True)

    def __init__(self, at, error):
        self.at, self.error, self.prepared = at, error, 0

    def _do(self, what):
        if what == self.at:
            raise self.error

    def cost(self, program):
        return 0.0

    def prepare(self, program, request):
        self.prepared += 1
        self._do("prepare")
        return self

    def update(self, program):
        self._do("update")

    def solve(self):
        self._do("solve")
        return Candidate(np.zeros(PROGRAM.n_variables))


@pytest.mark.parametrize("at", ["prepare", "solve"])
@pytest.mark.parametrize(
    "error",
    [
        NumericalError("no convergence"),
        np.linalg.LinAlgError("not positive definite"),
        FloatingPointError("overflow"),
    ],
)
@pytest.mark.usefixtures("ours")
def test_a_breakdown_is_an_answer_without_a_point(at, error):
    answer = Guarded(Brittle(at, error), PROGRAM, Request()).solve()
    assert answer.x is None and answer.claim is Claim.GAVE_UP
    assert answer.detail == f"{type(error).__name__}: {error}"


@pytest.mark.usefixtures("ours")
def test_what_broke_down_is_set_up_anew():
    solver = Brittle("update", ZeroDivisionError("by nothing"))
    guarded = Guarded(solver, PROGRAM, Request())
    guarded.update(PROGRAM)
    assert guarded.solve().claim is Claim.GAVE_UP
    solver.at = ""
    guarded.update(PROGRAM)
    assert guarded.solve().x is not None
    assert solver.prepared == 2


def test_auto_goes_on_to_the_next(monkeypatch):
    others = registry.candidates("auto", PROGRAM)
    brittle = Brittle("prepare", NumericalError("no convergence"))
    monkeypatch.setattr(registry, "candidates", lambda *_: [brittle, *others])
    solution = tt.fit(SCENE, "eq10")
    assert solution.status is tt.Status.SOLVED
    (attempt,) = solution.attempts
    assert attempt.solver == "brittle" and "no convergence" in attempt.detail


def test_a_users_own_breakdown_is_told_with_its_line():
    brittle = Brittle("solve", ZeroDivisionError("by nothing"))
    with pytest.raises(InputError, match=r"by nothing \(.*test_breakdown.py, line"):
        Guarded(brittle, PROGRAM, Request()).solve()


@pytest.mark.usefixtures("ours")
@pytest.mark.parametrize("error", [InputError("no such"), TypeError("a mistake")])
def test_mistakes_are_no_breakdowns(error):
    guarded = Guarded(Brittle("solve", error), PROGRAM, Request())
    with pytest.raises(type(error), match=str(error)):
        guarded.solve()


class Scaling(Solver, Prepared):
    """Scales what it is given in place, as if that were its own."""

    name, summary = "scaling", "scales blocks in place"
    capabilities = Capabilities(inequalities=True, equalities=True)

    def __init__(self, part):
        self.part = part

    def prepare(self, program, request):
        self.program = program
        return self

    def update(self, program):
        self.program = program

    def solve(self):
        term, scene = self.program.terms[1], self.program.laplace
        found = {
            "data": term.matrix.data,
            "indices": term.matrix.indices,
            "indptr": term.matrix.indptr,
            "target": term.target,
            "laplace": scene.L.data,
        }
        found[self.part] *= 2
        return Candidate(np.zeros(self.program.n_variables))


@pytest.mark.parametrize("part", ["data", "indices", "indptr", "target", "laplace"])
def test_a_users_solver_cannot_change_the_scene(part):
    declared = load("eq10", SCENE)
    before = tt.fit(SCENE, "eq10").objective
    refuses(InputError, "read-only", tt.fit, SCENE, declared, solver=Scaling(part))
    assert tt.fit(SCENE, "eq10").objective == before
    scale = SCENE.N.data  # to write to again, for whom it belongs to
    assert scale.flags.writeable
