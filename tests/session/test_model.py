"""The field of a session: fitted to some stretches, tested on all of them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import ellipsoid, presses, torso
from ttus_opt.errors import InputError
from ttus_opt.problem.program import Program
from ttus_opt.problem.solution import NoSolutionError
from ttus_opt.report.metrics import evaluate
from ttus_opt.session.description import FitPlan
from ttus_opt.session.model import fit_model, judge
from ttus_opt.solvers.base import Candidate, Capabilities, Prepared, Request, Solver
from ttus_opt.voxmap.voxmap import Voxmap

SURFACE, SHELL = torso(), ellipsoid()
SHAPE, R_INNER = (7, 14, 8), 0.03
RNG = np.random.default_rng(5)
RECORDINGS = {name: presses(SURFACE, 10, RNG) for name in ("first", "second", "third")}
USE = {"third": True, "first": False, "second": True}


def session(**changed: Any) -> Any:
    """Two stretches that are fitted and one that is not, in an order of their own."""
    told: dict[str, Any] = {
        "formulation": "eq10",
        "options": {"force_weight": 0.2},
        "weights": "own",
        "solver": "auto",
    }
    plan = FitPlan(shape=SHAPE, r_inner=R_INNER, **(told | changed))
    parts = [SimpleNamespace(name=name, fitted=use) for name, use in USE.items()]
    return SimpleNamespace(fit=plan, recordings=parts)


def scene() -> tt.Scene:
    voxmap = Voxmap.from_surface(SURFACE, shape=SHAPE, r_inner=R_INNER)
    both = tt.Trajectory.concatenate([RECORDINGS["third"], RECORDINGS["second"]])
    return tt.Scene.assemble(voxmap, SHELL, both, sampling="trilinear")


def test_the_field_is_that_of_the_stretches_that_are_fitted() -> None:
    found = fit_model(session(), SURFACE, SHELL, RECORDINGS)
    own = scene()
    for solution, name, options in (
        (found.before, "laplace_only", {}),
        (found.after, "eq10", {"force_weight": 0.2}),
    ):
        expected = tt.fit(own, name, **options).field.values
        size = np.abs(expected).max()
        np.testing.assert_allclose(solution.field.values, expected, atol=1e-6 * size)
    assert found.choice.formulation.name == found.after.formulation == "eq10"
    assert found.after.chosen == found.choice.lines


def test_every_stretch_is_judged_with_both_fields() -> None:
    """In the order of the description, with whether it was fitted."""
    model = fit_model(session(), SURFACE, SHELL, RECORDINGS)
    found = judge(session(), model, SHELL, RECORDINGS)
    assert [(c.recording, c.seen) for c in found] == list(USE.items())
    for each in found:
        own = RECORDINGS[each.recording]
        for solution, seen in ((model.before, each.before), (model.after, each.after)):
            assert seen.errors == evaluate(solution.field, SHELL, own).errors
        if each.seen:
            after, before = each.after.errors, each.before.errors
            assert after.force_vector_rmse_N < before.force_vector_rmse_N


class Wrong(Solver):
    """Answers with zeros, and says that it is done."""

    name, summary = "wrong", "zeros"
    capabilities = Capabilities(inequalities=True, equalities=True)

    def prepare(self, program: Program, request: Request) -> Prepared:
        answer = Candidate(np.zeros(program.n_variables))
        return SimpleNamespace(solve=lambda: answer)  # type: ignore[return-value]


def test_a_field_that_fails_its_check_is_no_model() -> None:
    with pytest.raises(NoSolutionError):
        fit_model(session(solver=Wrong()), SURFACE, SHELL, RECORDINGS)
    with pytest.raises(InputError, match="unknown formulation"):
        fit_model(session(formulation="eq11"), SURFACE, SHELL, RECORDINGS)
