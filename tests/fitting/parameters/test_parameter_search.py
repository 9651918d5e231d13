"""The search: what it takes for an optimum, and what it refuses."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene
from ttus_opt.fitting import batch
from ttus_opt.fitting.parameters import parameter_search
from ttus_opt.problem.formulation import Formulation, Search

SCENE = small_scene("trilinear", shape=(6, 12, 7))
SILENT = replace(SCENE, b=np.zeros_like(SCENE.b))  # then the cost grows with ‖f‖


@dataclass(frozen=True)
class Bowl(tt.terms.ForceTerm):
    """Forces that are best explained at a value of one's own."""

    value: float = 0.0
    best: float = 0.3
    depth: float = field(default=1.0)

    def rows(self):
        rows = super().rows()
        more = self.depth * (self.value - self.best) ** 2
        return replace(rows, target=rows.target * np.sqrt(1.0 + more))

    def parameters(self, values):
        return {"value": self.value}


def declared(low=0.0, high=1.0, best=0.3, depth=1.0):
    def build(value):
        bowl = Bowl(SILENT, 0.1, value, best, depth)
        return Formulation([tt.terms.LaplaceTerm(SILENT), bowl])

    return build(high).with_search(Search("value", low, high, build))


def unsolved_where(monkeypatch, low, high):
    """Fits in a range of values come back unsolved, with a tempting objective."""
    solve = tt.Fitter.solve

    def patched(self):
        solution = solve(self)
        if not low <= solution.parameters["value"] <= high:
            return solution
        told = {"status": tt.Status.INACCURATE, "objective": 0.0}
        return replace(solution, verified_field=None, **told)

    monkeypatch.setattr(batch.Fitter, "solve", patched)


def left_over(solution):
    """The objective without poses off the skin, and the rows of the others."""
    off = SILENT.rows.contact_points == 0
    force = solution.program.term("force")
    lost = force.weight * float((force.target.reshape(-1, 3)[off] ** 2).sum())
    return solution.objective - lost, 3 * int((~off).sum())


def test_the_vertex_is_found_and_its_error_told():
    """J = J₀ (1 + 100 (v - 0.3)²), so that J'' = 200 J₀ and σ̂² = J₀/(m - 1)."""
    solution = tt.fit(SILENT, declared(depth=100.0))
    assert solution.parameters["value"] == pytest.approx(0.3, abs=1e-4)
    rest, m = left_over(solution)
    expected = np.sqrt(2.0 * rest / (m - 1) / (200.0 * solution.objective))
    assert solution.standard_errors["value"] == pytest.approx(expected, rel=1e-3)
    assert not solution.not_identified
    assert not solution.remarks


def test_an_unsolved_fit_is_no_optimum(monkeypatch):
    """However small the objective is that it claims."""
    unsolved_where(monkeypatch, 0.6, 1.0)
    solution = tt.fit(SILENT, declared(depth=100.0))
    assert solution.status is tt.Status.SOLVED
    assert solution.parameters["value"] == pytest.approx(0.3, abs=1e-3)


def test_no_fit_along_the_search_was_solved(monkeypatch):
    unsolved_where(monkeypatch, 1e-9, 1.0)  # all but the neutral value's
    solution = tt.fit(SILENT, declared(depth=100.0))
    assert solution.status is tt.Status.INACCURATE
    assert solution.detail.startswith(
        "the search for value solved none of its fits, the last: "
    )
    refuses(tt.NoSolutionError, "", lambda: solution.field)


def test_a_fit_beside_the_optimum_fails(monkeypatch):
    """The value stands, its standard error does not."""
    unsolved_where(monkeypatch, 0.31, 0.33)
    solution = tt.fit(SILENT, declared(depth=100.0))
    assert solution.status is tt.Status.SOLVED
    assert solution.standard_errors == {}
    assert solution.remarks == {
        "value": "its standard error is unknown: a fit beside it was not solved"
    }


def test_a_search_that_does_not_end_is_not_solved(monkeypatch):
    monkeypatch.setattr(parameter_search, "MOST_FITS", 3)
    solution = tt.fit(SILENT, declared(depth=100.0))
    assert solution.status is tt.Status.INACCURATE
    assert "did not converge in 3 fits: narrow its range" in solution.detail


@pytest.mark.parametrize(("best", "limit"), [(1.4, "upper limit 1"), (-0.4, "lower")])
def test_an_optimum_at_the_edge_is_told(best, limit):
    solution = tt.fit(SILENT, declared(best=best, depth=100.0))
    assert solution.parameters["value"] == 0.0
    if limit == "lower":
        assert solution.remarks == {"value": "at its lower limit 0"}
        assert solution.not_identified == {}
    else:
        assert solution.not_identified == {"value": "at its upper limit 1"}
        assert solution.identified == (
            "value: not identified (at its upper limit 1): 0 is used",
        )


def test_a_flat_objective_tells_nothing():
    solution = tt.fit(SILENT, declared(depth=0.0))
    assert solution.status is tt.Status.SOLVED
    assert solution.parameters["value"] == 0.0
    assert solution.not_identified == {"value": "the objective does not depend on it"}


def test_a_nearly_flat_objective_is_doubted():
    solution = tt.fit(SILENT, declared(depth=0.1))
    assert solution.parameters["value"] == 0.0
    assert solution.not_identified["value"].startswith("the data give 0.3 ± ")


def test_two_parameters_are_found_together():
    """Coupled, so that one after the other is not yet the optimum of both."""

    def both(a):
        def build(b):
            return Formulation([tt.terms.LaplaceTerm(SILENT), Pair(SILENT, 0.1, a, b)])

        return build(0.0).with_search(Search("b", -1.0, 1.0, build, neutral=0.0))

    solution = tt.fit(
        SILENT, both(0.9).with_search(Search("a", -1.0, 1.0, both, neutral=0.0))
    )
    assert solution.parameters["a"] == pytest.approx(0.3, abs=1e-3)
    assert solution.parameters["b"] == pytest.approx(-0.2, abs=1e-3)
    rest, m = left_over(solution)
    spread = rest / (m - 2) * np.linalg.inv(PAIR) / solution.objective
    for k, name in enumerate("ab"):
        assert solution.standard_errors[name] == pytest.approx(
            np.sqrt(spread[k, k]), rel=1e-2
        )


PAIR = 50.0 * np.array([[1.0, 0.7], [0.7, 1.0]])


@dataclass(frozen=True)
class Pair(tt.terms.ForceTerm):
    a: float = 0.0
    b: float = 0.0

    def rows(self):
        rows = super().rows()
        off = np.array([self.a - 0.3, self.b + 0.2])
        return replace(rows, target=rows.target * np.sqrt(1.0 + off @ PAIR @ off))

    def parameters(self, values):
        return {"a": self.a, "b": self.b}


def test_the_neutral_value_lies_in_the_range():
    build = declared().search
    assert Search("value", 1.0, 2.0, build.build).neutral_value == 1.0
    assert Search("value", -2.0, -1.0, build.build).neutral_value == -1.0
    assert Search("value", -1.0, 1.0, build.build).neutral_value == 0.0
    with pytest.raises(
        InputError, match=r"neutral value of value must lie in \[0, 1\]"
    ):
        Search("value", 0.0, 1.0, build.build, neutral=2.0)


def test_search_is_told_in_the_time():
    assert tt.fit(SILENT, declared(depth=100.0)).timings.search is not None
    assert tt.fit(SILENT, "eq10").timings.search is None


def test_a_limit_that_is_not_neutral_is_no_value():
    """The scale of boundary values between 0.5 and 2, for instance."""
    made = declared(low=0.5, high=2.0, best=0.2, depth=100.0)
    solution = tt.fit(SILENT, made.with_search(replace(made.search, neutral=1.0)))
    assert solution.parameters["value"] == 1.0
    assert solution.not_identified == {"value": "at its lower limit 0.5"}


@pytest.mark.parametrize("bad", [(2.0, 3.0), (0.75, 0.77), (0.75, 0.85)])
def test_an_estimate_saves_the_search_where_the_minimum_is_beside_it(bad, monkeypatch):
    """Where a fit beside it is not solved, the whole range is searched."""
    unsolved_where(monkeypatch, *bad)
    searched, least = [], parameter_search._least
    monkeypatch.setattr(
        parameter_search,
        "_least",
        lambda *given: searched.append(least(*given)) or searched[-1],
    )
    whole = declared(depth=100.0)
    likely = whole.with_search(replace(whole.search, likely=0.78))
    solution = tt.fit(SILENT, likely)
    assert len(searched) == (bad[0] < 1.0)
    assert solution.parameters["value"] == pytest.approx(0.3, abs=1e-4)
    assert solution.standard_errors == pytest.approx(
        tt.fit(SILENT, whole).standard_errors, rel=1e-3
    )
