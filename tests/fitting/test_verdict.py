"""Solvers' answers are judged, and breakdowns are no answer."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse.linalg

import ttus_opt as tt
from tests.kit import InputError, NumericalError, refuses, small_scene
from tests.solvers.problems import bounds, program, rows, term
from ttus_opt.fitting import verdict
from ttus_opt.fitting.verdict import (
    CONFLICT_SECONDS,
    Guarded,
    checked_candidate,
    judged,
)
from ttus_opt.problem.formulation import load
from ttus_opt.problem.reduction import Reduction, reduce
from ttus_opt.problem.solution import Status, Timings
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)

FEW = small_scene("trilinear", shape=(6, 10, 6), n_poses=6)
PROGRAM = load("eq10", FEW).compile()


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
    solution = tt.fit(FEW, "eq10")
    assert solution.status is tt.Status.SOLVED
    (attempt,) = solution.attempts
    assert attempt.solver == "brittle" and "no convergence" in attempt.detail


def test_a_users_own_breakdown_is_told_with_its_line():
    brittle = Brittle("solve", ZeroDivisionError("by nothing"))
    with pytest.raises(InputError, match=r"by nothing \(.*test_verdict.py, line"):
        Guarded(brittle, PROGRAM, Request()).solve()


@pytest.mark.usefixtures("ours")
@pytest.mark.parametrize("error", [InputError("no such"), TypeError("a mistake")])
def test_mistakes_are_no_breakdowns(error):
    guarded = Guarded(Brittle("solve", error), PROGRAM, Request())
    refuses(type(error), str(error), guarded.solve)


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
    declared = load("eq10", FEW)
    before = tt.fit(FEW, "eq10").objective
    refuses(InputError, "read-only", tt.fit, FEW, declared, solver=Scaling(part))
    assert tt.fit(FEW, "eq10").objective == before
    scale = FEW.N.data  # to write to again, for whom it belongs to
    assert scale.flags.writeable


SCENE = small_scene("trilinear")
EQ10 = load("eq10", SCENE)
TIMES = Timings(0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def answer():
    """The minimum of eq. 10, by one factorisation."""
    terms = EQ10.compile().terms
    A = sum(t.weight * (t.matrix.T @ t.matrix) for t in terms)
    b = sum(t.weight * (t.matrix.T @ t.target) for t in terms)
    return np.asarray(scipy.sparse.linalg.spsolve(A.tocsc(), b))


def told(candidate, reduction=None):
    return judged(
        EQ10,
        reduction or reduce(EQ10.compile()),
        "package",
        candidate,
        Request(1e-6),
        TIMES,
    )


@pytest.mark.parametrize(
    ("claim", "error", "status", "remark"),
    [
        (Claim.DONE, 0.0, Status.SOLVED, ""),
        (Claim.TIME_LIMIT, 0.0, Status.SOLVED, ""),
        (Claim.DOUBTS, 0.0, Status.SOLVED, ""),  # proved without the solver
        (Claim.INFEASIBLE, 0.0, Status.SOLVED, ""),
        (Claim.DONE, 0.1, Status.INACCURATE, ""),
        (Claim.TIME_LIMIT, 0.1, Status.TIME_LIMIT, ""),
        (Claim.UNBOUNDED, 0.1, Status.INACCURATE, "solver's word, without a proof"),
    ],
)
def test_residuals_decide_not_the_claim(answer, claim, error, status, remark):
    found = told(Candidate((1.0 + error) * answer, claim=claim, detail="its words"))
    assert found.status is status
    assert found.detail.startswith("its words")
    assert remark in found.detail
    assert (found.verified_field is not None) == (status is Status.SOLVED)


def test_no_answer_is_a_failure():
    found = told(Candidate(None, claim=Claim.GAVE_UP))
    assert found.status is Status.FAILED
    assert found.kkt is None
    assert np.isnan(found.objective)


def test_a_contradiction_needs_a_proof_and_is_named():
    """2 ≤ x₀ against x₀ ≤ 1; without the second, "infeasible" is a mere word."""
    reach = program(
        [term(np.eye(2), [0.0, 0.0])], [rows("reach", [[1, 0]], [2.0], [np.inf])]
    )
    limit = bounds("limit", [-np.inf, -np.inf], [1.0, np.inf])
    contrary = replace(reach, bounds=(limit,))
    none = Candidate(None, claim=Claim.INFEASIBLE)
    for claim in (Claim.INFEASIBLE, Claim.GAVE_UP):  # whatever it says
        found = told(replace(none, claim=claim), Reduction(contrary, contrary))
        assert found.status is Status.INFEASIBLE
        assert set(found.conflict) == {"reach", "limit"}
    late = replace(none, claim=Claim.TIME_LIMIT)  # a proof would take more time
    assert told(late, Reduction(contrary, contrary)).status is Status.TIME_LIMIT
    found = told(none, Reduction(reach, reach))
    assert found.status is Status.FAILED
    assert "without a proof" in found.detail


def test_a_solver_s_own_proof_names_the_conflict():
    """Of two conflicts the one it proves; multipliers of an answer prove nothing."""
    both = program(
        [term(np.eye(2), [0.0, 0.0])],
        [
            rows("reach", [[1, 0]], [2.0], [np.inf]),
            rows("limit", [[1, 0]], [-np.inf], [1.0]),
            rows("rise", [[0, 1]], [5.0], [np.inf]),
            rows("fall", [[0, 1]], [-np.inf], [4.0]),
        ],
    )
    proof = Duals({"rise": np.array([-1.0]), "fall": np.array([1.0])}, None)
    claimed = Candidate(None, proof, claim=Claim.INFEASIBLE)
    found = told(claimed, Reduction(both, both))
    assert found.status is Status.INFEASIBLE
    assert set(found.conflict) == {"rise", "fall"}
    for other in (replace(claimed, duals=None), replace(claimed, x=np.zeros(2))):
        found = told(other, Reduction(both, both))
        assert set(found.conflict) == {"reach", "limit", "rise", "fall"}


def test_proofs_are_looked_for_no_longer_than_a_fit_may_take(monkeypatch):
    given = []

    def sought(*_, time_limit, **__):
        given.append(time_limit)

    monkeypatch.setattr(verdict, "falling_ray", sought)
    monkeypatch.setattr(verdict, "conflicting", lambda *_, **k: sought(**k) or ())
    reach = program([term(np.eye(2), [0, 0])], [rows("reach", [[1, 0]], [2], [3])])
    for claim in (Claim.UNBOUNDED, Claim.INFEASIBLE):
        for limit in (None, 3.0):
            candidate = Candidate(np.zeros(2), claim=claim)
            both = Reduction(reach, reach)
            judged(EQ10, both, "package", candidate, Request(1e-6, limit), TIMES)
    assert given == [CONFLICT_SECONDS] * 2 + [3.0] * 2 + [CONFLICT_SECONDS, 3.0]


ZERO = np.zeros(2)

#: Where a vector of two numbers is wanted
NO_VECTORS = (
    [0.0, 0.0],
    np.zeros(2, complex),
    np.array([0.0, None]),
    np.ma.array([0.0, 0.0]),
    np.zeros((2, 1)),
    np.array(["a", "b"]),
    0.0,
    np.float64(0.0),
    "answer",
    np.array(0.0),
)


def test_an_answer_is_copied_once():
    """A solver may use its arrays again."""
    small = program([term(np.eye(2), [0.0, 0.0])], [rows("reach", [[1, 0]], [2], [3])])
    x, y, z = np.zeros(2), np.zeros(1), np.zeros(2, np.float32)
    found = checked_candidate(Candidate(x, Duals({"reach": y}, z)), small, "mine")
    x += 1.0
    y += 1.0
    z += 1.0
    for own in (found.x, found.duals.rows["reach"], found.duals.bounds):
        assert not own.any() and own.dtype == np.float64


@pytest.mark.parametrize(
    ("candidate", "words"),
    [
        ("done", "must return a Candidate, got str"),
        (Candidate(np.zeros(3)), r"x must .* of shape \(2,\), got .* \(3,\)"),
        (Candidate(np.zeros(2), Duals({}, np.zeros(1))), r"duals\.bounds must be"),
        (
            Candidate(np.zeros(2), Duals({"reach": np.zeros(2)})),
            r"duals\.rows\['reach'\] must .* of shape \(1,\)",
        ),
        *((Candidate(x), "mine: its x must be an array of real") for x in NO_VECTORS),
        *((Candidate(ZERO, Duals({}, x)), r"its duals\.bounds") for x in NO_VECTORS),
        *(
            (
                Candidate(ZERO, Duals({"reach": x})),
                r"its duals\.rows\['reach'\] must be",
            )
            for x in (None, *NO_VECTORS)
        ),
        (Candidate(ZERO, Duals({}, None, {"f": "a"})), r"its duals\.terms\['f'\] must"),
        (Candidate(ZERO, None), "its duals must be Duals, got NoneType"),
        (Candidate(ZERO, Duals(None)), r"its duals\.rows must be vectors by con"),
        (Candidate(ZERO, detail=3), "its detail must be a text, got int"),
        (Candidate(ZERO, claim="done"), "its claim must be a Claim, got str"),
        (Candidate(ZERO, iterations=1.5), "its iterations must be a whole"),
    ],
)
def test_the_form_of_an_answer_is_checked(candidate, words):
    small = program([term(np.eye(2), [0.0, 0.0])], [rows("reach", [[1, 0]], [2], [3])])
    refuses(InputError, words, checked_candidate, candidate, small, "mine")
