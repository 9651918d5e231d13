"""Finding, refusing and choosing solvers; what a backend says of itself."""

import math

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import InputError, SolverUnavailableError, refuses, small_scene
from tests.solvers.own_terms import AlongZ
from tests.solvers.problems import bounds, program, rows, term
from tests.solvers.taking import ALGEBRAIC, BENT
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.terms.penalties import Groups
from ttus_opt.problem.terms.wrench import ForceTerm
from ttus_opt.solvers import registry, verified
from ttus_opt.solvers.base import Capabilities, Claim, Request, Solver

ALL = list(registry.solvers().values())


@pytest.mark.parametrize("solver", ALL, ids=lambda s: s.name)
def test_says_who_it_is(solver):
    assert solver.summary
    assert bool(solver.module) == bool(solver.pip_name)


def bounded(n):
    """A box over n variables."""
    zero, one = np.zeros(n), np.ones(n)
    fit = ProgramTerm("fit", 1.0, sp.eye_array(n, format="csr"), one)
    return program([fit], (), [bounds("box", zero, one)])


class Costing(Solver):
    """A solver with an estimate that takes anything."""

    summary = "stands for another"
    capabilities = Capabilities(inequalities=True, equalities=True, nonquadratic=True)

    def __init__(self, name, seconds):
        self.name, self.seconds = name, seconds

    def cost(self, program):
        return self.seconds

    def prepare(self, program, request):
        raise AssertionError


def test_auto_takes_the_cheapest_and_keeps_the_others(monkeypatch):
    offered = [Costing("slow", 3.0), Costing("fast", 1.0), Costing("never", math.inf)]
    monkeypatch.setattr(registry, "solvers", lambda: {s.name: s for s in offered})
    order = [s.name for s in registry.candidates("auto", bounded(3))]
    assert order == ["fast", "slow"]


def test_auto_takes_interior_point_when_small_and_splitting_when_large():
    """A small box, and a grid whose factor an interior point repeats."""
    assert registry.choose("auto", bounded(10)).name == "clarabel"
    scene = small_scene("trilinear", shape=(24, 48, 24), n_poses=6)
    robust = reduce(load("robust", scene).compile()).program
    clarabel, scs = (registry.solvers()[name] for name in ("clarabel", "scs"))
    assert scs.cost(robust) < clarabel.cost(robust)


def test_estimates_grow_with_the_grid_and_with_limits():
    small, large = (
        load("eq10", small_scene("trilinear", shape=shape)).compile()
        for shape in ((9, 20, 10), (18, 40, 20))
    )
    one = small_scene("trilinear", shape=(9, 20, 10))
    limited = load("eq10_sign", one).compile()
    asked = [registry.solvers()[name] for name in registry.estimating()]
    able = [solver for solver in asked if not solver.refusal(small)]
    assert {"structured", "normal_equations", "clarabel", "scs"} <= {
        solver.name for solver in able
    }
    for solver in able:
        assert solver.cost(small) < solver.cost(large)
        assert solver.cost(small) < solver.cost(limited)


def test_auto_never_takes_a_reference():
    assert {"amg_pcg", "closed_form"} <= set(registry.solvers())
    assert not {"amg_pcg", "closed_form"} & set(registry.estimating())


def test_auto_takes_cones_for_group_norms():
    bent = program([term(np.eye(2), [1, 1], 1.0, Groups(2))])
    assert registry.choose("auto", bent).name == "cvxpy_clarabel"


def test_unknown_name_gets_the_nearest():
    plain = program([term(np.eye(1), [1])])
    refuses(InputError, "did you mean clarabel", registry.choose, "clarabell", plain)


def test_solver_that_is_not_installed_gives_its_pip_name(monkeypatch):
    plain = program([term(np.eye(1), [1])])
    solver = registry.solvers()["osqp"]
    monkeypatch.setattr(solver, "module", "osqp_that_is_not_here")
    assert not solver.installed
    refuses(SolverUnavailableError, "pip install osqp", registry.choose, "osqp", plain)


@pytest.mark.parametrize(
    ("what", "refusing"),
    [
        (
            program([term(np.eye(1), [1])], (), [bounds("box", [0], [1])]),
            ["closed_form", "structured", "amg_pcg"],
        ),
        (
            program([term(np.eye(1), [1])], [rows("equal", [[1]], [1], [1])]),
            ["closed_form", "highs"],
        ),
        (program([term(np.eye(1), [1])]), ["structured", "highs", "amg_pcg"]),
        (
            program([term(np.eye(1), [1], 1.0, Groups(1))]),
            ["clarabel", "osqp", "closed_form"],
        ),
    ],
    ids=["bounds", "equality", "no laplace", "group norm"],
)
def test_refusals(what, refusing):
    for name in refusing:
        solver = registry.solvers()[name]
        assert solver.refusal(what)
        if solver.installed:
            refuses(
                InputError, f"solver {name} cannot take", registry.choose, name, what
            )


@pytest.mark.parametrize("over", [False, True], ids=["soon over", "just over"])
@pytest.mark.parametrize(
    "solver",
    [s for s in ALL if s.installed and s.capabilities.time_limit],
    ids=lambda s: s.name,
)
def test_time_limit_strikes(solver, over, monkeypatch):
    scene = small_scene("trilinear", shape=(9, 20, 10))
    declared = load("eq10", scene, force_weight=1.0, torque_weight=1.0)
    problem = declared.compile()
    if not solver.refusal(declared.with_constraints(Sign(scene)).compile()):
        problem = declared.with_constraints(Sign(scene)).compile()
    if solver.name in BENT:
        problem = reduce(load("sparse_sources", scene).compile()).program
    if solver.name in ALGEBRAIC:
        problem = Formulation([AlongZ(scene), ForceTerm(scene, 1.0)]).compile()
    if over:  # it ends between the look at the clock and the package's start
        late = iter([False])
        monkeypatch.setattr(verified, "is_late", lambda deadline: next(late, True))
    candidate = solver.prepare(problem, Request(1e-12, 1e-9 if over else 1e-4)).solve()
    assert candidate.claim is Claim.TIME_LIMIT


def test_request_refuses_what_cannot_be_asked():
    refuses(InputError, "tolerance", Request, 0.0)
    refuses(InputError, "time_limit", Request, 1e-6, -1.0)
