"""A user's own solver: by path and as an object, to another process and back."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.benchmark.tiny import TINY
from tests.kit import InputError, refuses
from tests.oracles.dense import minimiser
from tests.solvers.problems import INF, bounds, program, rows, term
from ttus_opt.benchmark import solver_run
from ttus_opt.benchmark.cases import reference_cases, with_new_values
from ttus_opt.benchmark.machine import KEPT, Progress
from ttus_opt.benchmark.row import RunSpec
from ttus_opt.benchmark.solver_run import active_limits, options_of, solver_of
from ttus_opt.problem.formulation import load
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.base import Candidate, Claim, Prepared
from ttus_opt.solvers.packages.closed_form import ClosedForm

FILE = """
from ttus_opt.solvers.packages.closed_form import ClosedForm

class Mine(ClosedForm):
    name = "mine"

SOLVERS = [Mine()]
"""


class Renamed(ClosedForm):
    """An object of an importable class."""

    name = "renamed"


def own_file(folder):
    path = folder / "mine.py"
    path.write_text(FILE)
    return path


def test_a_file_and_an_object_come_back_from_json(tmp_path):
    path = own_file(tmp_path)
    for given, name in ((str(path), "mine"), (path, "mine"), (Renamed(), "renamed")):
        options = json.loads(json.dumps(options_of(given)))
        assert options["solver"] == name
        found = solver_of(options)
        assert found != "auto"
        assert found.name == name
    assert options_of("osqp") == {"solver": "osqp"}
    before = options_of(path)
    path.write_text(FILE + "# another version\n")
    assert options_of(path) != before


def test_auto_is_a_solver_of_its_own():
    assert options_of("auto") == {"solver": "auto"}
    assert solver_of({"solver": "auto"}) == "auto"


def test_what_cannot_travel_is_refused(tmp_path):
    class Local(ClosedForm):
        name = "local"

    refuses(InputError, "give its path", options_of, Local())
    clash = tmp_path / "clash.py"
    clash.write_text(FILE.replace('"mine"', '"osqp"'))
    refuses(InputError, "another name", options_of, clash)
    refuses(InputError, "not found", options_of, tmp_path / "gone.py")


CASE = replace(TINY, shape=(6, 9, 6), n_poses=5, n_points=200)


def spec_of(time_limit=60.0, **options):
    asked = {
        "formulation": "eq10",
        "options": {"force_weight": 0.3, "torque_weight": 0.1},
        "solver": "closed_form",
        "tolerance": 1e-6,
        "repeat": 1,
    }
    return RunSpec("solvers", CASE, asked | options, time_limit)


def measured(folder, spec):
    return solver_run.measured(spec, Progress(folder))


def test_a_row_tells_of_the_minimiser_and_of_every_repeat(tmp_path):
    spec = spec_of(repeat=3)
    row = measured(tmp_path, spec)
    program = load("eq10", CASE.scene(), **spec.options["options"]).compile()
    p = minimiser(program)
    assert (row["status"], row["taken"], row["poses"]) == ("solved", "closed_form", 5)
    assert row["objective"] == pytest.approx(program.objective(p), rel=1e-9)
    kept = np.load(tmp_path / KEPT / solver_run.FIELDS / row["field_file"])
    np.testing.assert_allclose(kept, p, atol=1e-8 * np.abs(p).max())
    assert row["field_file"] == f"tiny-eq10-closed_form-{spec.key[-12:]}.npy"
    assert row["active_limits"] == 0
    for name in ("first", "again"):
        each = row["seconds_each"][name]
        assert len(each) == 3 and min(each) > 0.0
        assert row[f"seconds_{name}"] == sorted(each)[1]


class Failing(ClosedForm):
    """Gives up from some solve of the case on; its stand-in has other poses.

    Attributes:
        seen: Measured forces of every solve of the case, shape (3 T,) [N].
    """

    name = "failing"

    def __init__(self, after):
        self._left = after
        self.seen: list[np.ndarray] = []

    def prepare(self, program, request):
        return _Failing(self, super().prepare(program, request), program)

    def solved(self, forces):
        """Whether to solve once more."""
        if len(forces) == 3 * CASE.n_poses:
            self.seen.append(forces)
            self._left -= 1
        return self._left >= 0


class _Failing(Prepared):
    def __init__(self, owner, real, program):
        self._owner, self._real = owner, real
        self.update(program)

    def update(self, program):
        self._forces = next(t.target for t in program.terms if t.name == "force")
        self._real.update(program)

    def solve(self):
        if self._owner.solved(self._forces):
            return self._real.solve()
        return Candidate(None, claim=Claim.GAVE_UP, detail="had\n  enough")


def failing(monkeypatch, after):
    solver = Failing(after)
    monkeypatch.setattr(solver_run, "solver_of", lambda options: solver)
    return solver


def test_the_same_program_is_solved_again_with_other_values(monkeypatch, tmp_path):
    solver = failing(monkeypatch, 100)
    row = measured(tmp_path, spec_of(repeat=2))
    own, other = CASE.scene().f, with_new_values(CASE.scene(), seed=1).f
    assert not np.allclose(own, other)
    np.testing.assert_array_equal(solver.seen, [own, other] * 2)
    program = load("eq10", CASE.scene(), **spec_of().options["options"]).compile()
    best = program.objective(minimiser(program))
    assert row["objective"] == pytest.approx(best, rel=1e-9)  # of the first one


def test_no_answer_is_a_row_without_figures(monkeypatch, tmp_path):
    failing(monkeypatch, 0)
    row = measured(tmp_path, spec_of(repeat=3))
    assert (row["status"], row["detail"]) == ("failed", "had enough")
    assert len(row["seconds_each"]["first"]) == 1  # no repeat
    assert not {"field_file", "seconds_again", "active_limits"} & set(row)
    assert not list(tmp_path.rglob("*.npy"))


def test_what_fails_on_other_values_only_says_so(monkeypatch, tmp_path):
    failing(monkeypatch, 1)
    row = measured(tmp_path, spec_of())
    assert row["status"] == "solved"
    assert row["detail"].startswith("solved first, then ")
    assert row["detail"].endswith(" on other values")
    assert "seconds_again" not in row


def test_an_answer_after_its_time_is_none(monkeypatch, tmp_path):
    """A solver that looks at no clock; nor is there a second round."""
    failing(monkeypatch, 100)
    row = measured(tmp_path, spec_of(1e-9, repeat=3))
    assert row["status"] == "time limit"
    assert row["detail"].startswith("solved after ")
    assert len(row["seconds_each"]["first"]) == 1


#: A small case whose limits hold back or not
TINY = replace(
    reference_cases("S")[0], name="tiny", shape=(9, 20, 9), n_poses=24, n_points=300
)


def test_by_hand():
    # ‖x - (-1, 2, -3e-9, 5)‖² with x ≥ 0, x₂ ≤ 1 and x₄ = 4: two bounds hold back, a
    # third by nothing that counts; the equality is no limit
    target = np.array([-1.0, 2.0, -3e-9, 5.0])
    problem = program(
        [term(np.eye(4), target)],
        [rows("given", [[0, 0, 0, 1]], [4.0], [4.0])],
        [bounds("box", np.zeros(4), [INF, 1.0, INF, INF])],
    )
    x = np.array([0.0, 1.0, 0.0, 4.0])
    z = np.array([-2.0, 2.0, -6e-9, 0.0])
    assert active_limits(problem, x, Duals({"given": np.array([2.0])}, z)) == 2
    assert active_limits(problem, x, Duals({"given": np.array([2.0])})) == 0
    # an interior point's remains where nothing holds back: they are all alike
    remains = Duals({"given": np.array([2.0])}, np.full(4, -1e-8))
    assert active_limits(problem, x, remains) == 0


def test_inequality_rows_count():
    problem = program(
        [term(np.eye(2), [3.0, 3.0])],
        [rows("most", [[1, 0], [0, 1], [1, 1]], [-INF] * 3, [1.0, 2.0, 9.0])],
    )
    duals = Duals({"most": np.array([4.0, 2.0, 0.0])})
    assert active_limits(problem, np.array([1.0, 2.0]), duals) == 2
