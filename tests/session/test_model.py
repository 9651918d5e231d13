"""The field of a session: fitted to some stretches, tested on all of them."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, MistakeWarning, TtusWarning, ellipsoid, presses, torso
from ttus_opt import example
from ttus_opt.session import model
from ttus_opt.session.description import FitPlan
from ttus_opt.session.model import KEYS, fit_model, judge
from ttus_opt.solvers.base import Candidate, Capabilities, Solver

SURFACE, SHELL = torso(), ellipsoid()
SHAPE, R_INNER = (7, 14, 8), 0.03
RNG = np.random.default_rng(5)
RECORDINGS = {name: presses(SURFACE, 10, RNG) for name in ("first", "second", "third")}
USE = {"third": True, "first": False, "second": True}


def session(**changed):
    """Two stretches that are fitted and one that is not, in an order of their own."""
    told = {
        "formulation": "eq10",
        "options": {"force_weight": 0.2},
        "weights": "own",
        "solver": "auto",
    }
    plan = FitPlan(shape=SHAPE, r_inner=R_INNER, **(told | changed))
    return SimpleNamespace(fit=plan, fitted=[name for name, use in USE.items() if use])


def scene():
    voxmap = tt.Voxmap.from_surface(SURFACE, shape=SHAPE, r_inner=R_INNER)
    both = tt.Trajectory.concatenate([RECORDINGS["third"], RECORDINGS["second"]])
    return tt.Scene.assemble(voxmap, SHELL, both, sampling="trilinear")


def test_the_field_is_that_of_the_stretches_that_are_fitted():
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


def test_every_stretch_is_judged_with_both_fields():
    """In their order, with whether each was fitted."""
    both = fit_model(session(), SURFACE, SHELL, RECORDINGS)
    fields = both.before.field, both.after.field
    ordered = {name: RECORDINGS[name] for name in USE}
    found = judge(fields, SHELL, ordered, session().fitted)
    assert [(c.recording, c.seen) for c in found] == list(USE.items())
    for each in found:
        own = RECORDINGS[each.recording]
        for solution, seen in ((both.before, each.before), (both.after, each.after)):
            assert seen.errors == tt.evaluate(solution.field, SHELL, own).errors
        if each.seen:
            after, before = each.after.errors, each.before.errors
            assert after.force_vector_rmse_N < before.force_vector_rmse_N


class Wrong(Solver):
    """Answers with zeros, and says that it is done."""

    name, summary = "wrong", "zeros"
    capabilities = Capabilities(inequalities=True, equalities=True)

    def prepare(self, program, request):
        answer = Candidate(np.zeros(program.n_variables))
        return SimpleNamespace(solve=lambda: answer)


def test_a_formulation_that_cannot_be_tuned_keeps_its_weights_aloud():
    huber = session(formulation="robust", options={}, weights="auto")
    with pytest.warns(TtusWarning, match="weights were not chosen.*cannot be tuned"):
        found = fit_model(huber, SURFACE, SHELL, RECORDINGS)
    assert found.choice.tuning is None and found.after.formulation == "robust"


def test_a_field_that_fails_its_check_is_no_model():
    with pytest.raises(tt.NoSolutionError):
        fit_model(session(solver=Wrong()), SURFACE, SHELL, RECORDINGS)
    with pytest.raises(InputError, match="unknown formulation"):
        fit_model(session(formulation="eq11"), SURFACE, SHELL, RECORDINGS)


def spoilt(press, cause):
    """A recording as one wrong line of the description reads it."""
    turn = Rotation.from_euler("x", 90.0, degrees=True).as_matrix()
    R, Rt = press.rotation, press.rotation.transpose(0, 2, 1)

    def turned(matrices):
        both = {"force": press.force, "torque": press.torque}
        return {k: (matrices @ v[..., None])[..., 0] for k, v in both.items()}

    arm = np.cross((R @ [0.05, 0.0, 0.0]), press.force)
    late = np.maximum(np.arange(len(press)) - int(0.5 / np.diff(press.time)[0]), 0)
    changes = {
        "flip_wrench": {"force": -press.force, "torque": -press.torque},
        "wrench_frame": turned(Rt),
        "wrench_axes": turned(R @ turn @ Rt),
        "probe_axes": {"rotation": R @ turn, **turned(R @ turn @ Rt)},
        "wrench_delay": {"force": press.force[late], "torque": press.torque[late]},
        "torque_about": {"torque": press.torque + arm},
        "torque_unit": {"torque": 1e3 * press.torque},
    }
    return replace(press, **changes[cause])


class JudgedError(Exception):
    """Instead of a solve."""


def no_solve(*_, **__):
    raise JudgedError


@pytest.mark.parametrize("cause", KEYS)
@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_a_likely_mistake_is_named_by_its_key(cause, monkeypatch):
    """Before anything is solved, with a warning that --strict makes an error."""
    press = spoilt(tt.read_trajectory(example.path("press_fit.csv")), cause)
    plan = replace(session().fit, shape=(8, 20, 8), r_inner=0.03)
    told = SimpleNamespace(fit=plan, fitted=["press"])
    surface = tt.Surface.load(example.path("surface.nc"))
    shell = tt.PointShell.from_spec(example.PROBE, n_points=120)
    monkeypatch.setattr(model, "fit", no_solve)
    named = re.escape(f"check {KEYS[cause]} in the description")
    with pytest.warns(MistakeWarning, match=named), pytest.raises(JudgedError):
        fit_model(told, surface, shell, {"press": press})
