"""A user's own solver: as an object, by path, from another package."""

import importlib.metadata
from types import SimpleNamespace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Candidate, Capabilities, Prepared, Solver

SCENE = small_scene(shape=(5, 8, 6), n_poses=5)

FILE = """
import numpy as np
from ttus_opt.solvers.base import Candidate, Capabilities, Prepared, Solver

class Loaded(Prepared):
    def update(self, program):
        self.program = program
    def solve(self):
        Q, d = self.program.normal_equations()
        return Candidate(ANSWER)

class Mine(Solver):
    name = "mine"
    summary = "dense"
    capabilities = Capabilities(inequalities=False, equalities=False)
    loaded = Loaded

SOLVERS = [Mine()]
"""
DENSE = "np.linalg.solve(Q.toarray(), d)"


class Dense(Solver):
    name = "dense"
    summary = "dense normal equations"
    capabilities = Capabilities(inequalities=False, equalities=False)

    def __init__(self, scale=1.0):
        self.scale = scale

    def prepare(self, program, request):
        self.require(program)
        return _Loaded(program, self.scale)


class _Loaded(Prepared):
    def __init__(self, program, scale):
        self.scale = scale
        self.update(program)

    def update(self, program):
        self.Q, self.d = program.normal_equations()

    def solve(self):
        return Candidate(self.scale * np.linalg.solve(self.Q.toarray(), self.d))


@pytest.fixture
def fresh():
    registry.solvers.cache_clear()
    yield
    registry.solvers.cache_clear()


def test_an_object_is_verified_like_any_other():
    """A right answer is solved, one that is 1 % off is not."""
    solution = tt.fit(SCENE, "eq10", solver=Dense())
    assert (solution.solver, solution.status) == ("dense", tt.Status.SOLVED)
    expected = tt.fit(SCENE, "eq10", solver="closed_form")
    np.testing.assert_allclose(solution.field.values, expected.field.values, atol=1e-8)
    assert tt.fit(SCENE, "eq10", solver=Dense(1.01)).status is tt.Status.INACCURATE


def test_an_object_says_what_it_cannot_take():
    with pytest.raises(InputError, match=r"solver dense cannot take .* no bounds"):
        tt.fit(SCENE, "eq10_sign", solver=Dense())


def test_a_file_by_path(tmp_path):
    own = tmp_path / "mine.py"
    own.write_text(FILE.replace("ANSWER", DENSE))
    for given in (own, str(own)):
        solution = tt.fit(SCENE, "eq10", solver=given)
        assert (solution.solver, solution.status) == ("mine", tt.Status.SOLVED)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            FILE.replace("ANSWER", "1 / 0"),
            r"solver mine raised ZeroDiv.*own.py, line 10",
        ),
        (
            FILE.replace("    loaded = Loaded\n", ""),
            r"solver mine has neither `loaded`.* nor a prepare",
        ),
        (
            FILE.replace("ANSWER", "d[:3]"),
            r"x must be .* shape \(240,\), got .* \(3,\)",
        ),
        (
            FILE.replace("Candidate(ANSWER)", "d"),
            "must return a Candidate, got ndarray",
        ),
        ("SOLVERS = [3]\n", "has no solvers"),
        ("x = 1\n", "has no solvers"),
        ("def broken(:\n", "SyntaxError.*line 1"),
    ],
)
def test_a_file_that_cannot_be_used(tmp_path, text, told):
    own = tmp_path / "own.py"
    own.write_text(text)
    refuses(InputError, told, tt.fit, SCENE, "eq10", solver=own)


def test_what_is_no_solver_is_refused(tmp_path):
    for given, told in (
        (tmp_path / "none.py", "solver file not found"),
        (3, "takes a name, the path of a file, or an in"),
    ):
        refuses(InputError, told, tt.fit, SCENE, "eq10", solver=given)


@pytest.mark.usefixtures("fresh")
def test_another_package_offers_solvers_and_formulations(monkeypatch):
    """By entry points; a name of ours stays ours."""
    from formulations.laplace_only import build
    from ttus_opt.problem.formulation import ENTRY_POINTS, available

    def entries(*, group):
        offered = {
            registry.ENTRY_POINTS: [("dense", Dense)],
            ENTRY_POINTS: [("theirs", build), ("eq10", 3)],
        }
        return [
            SimpleNamespace(name=name, load=lambda given=given: given)
            for name, given in offered.get(group, [])
        ]

    monkeypatch.setattr(importlib.metadata, "entry_points", entries)
    solution = tt.fit(SCENE, "theirs", solver="dense")
    assert (solution.solver, solution.formulation) == ("dense", "theirs")
    assert tt.fit(SCENE, "eq10").status is tt.Status.SOLVED
    assert "theirs" in [info.name for info in available()]
